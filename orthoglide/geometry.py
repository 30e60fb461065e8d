"""The nominal machine: dimensions, legs and their frames, named postures.

Leg ``i`` carries a frame with columns ``(a, b, c)``: ``a`` is its slide, ``b`` the pivots of its
parallelogram, ``c`` its first and last revolute and the direction of its short links. On the
Orthoglide it is a cyclic permutation of the base axes: for leg x, a = x, b = y, c = z.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide import layout as layouts
from orthoglide.arguments import public
from orthoglide.errors import InputError, UnreachableError, as_float_array, check_choice

Array = NDArray[np.float64]

Mode = Literal["machine", "other"]
"""The machine's own assembly mode, or its mirror image in the plane of the carriages."""

LEGS = ("x", "y", "z")
"""The base axes, and the Orthoglide's legs: its leg i slides along base axis i."""

_FAR = 4.0  # bar lengths beyond the stroke, where two legs no longer meet
_LARGEST = 10.0  # metres
_USUAL_BAR_LENGTHS = 0.15, 0.6  # metres: machines whose parts are made to the same tolerances


@dataclass(frozen=True)
class Pose:
    """Pose of the platform.

    Attributes:
        p: TCP ``(..., 3)``, metres.
        R: rotation of the platform ``(..., 3, 3)``, the identity of a machine without errors.
    """

    p: Array
    R: Array


def vectors(values: ArrayLike, name: str) -> Array:
    """Return points or commands ``(..., 3)`` as an array, metres; messages call them ``name``.

    Raises:
        InputError: for another shape, or values that are not finite numbers.
    """
    array = as_float_array(name, values)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError(f"{name} must have shape (..., 3), not {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite numbers of shape (..., 3), in metres")
    return array


def align_points(points: Array, source: Array, target: Array) -> Array:
    """Return points ``(n, 3)`` after the rigid motion that fits ``source`` to ``target``.

    The fit is least squares by singular values, without reflection (Kabsch 1976).
    """
    centre, goal = source.mean(axis=0), target.mean(axis=0)
    left, _, right = np.linalg.svd((source - centre).T @ (target - goal))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray((points - centre) @ (left @ flip @ right) + goal)


def rotation_columns(points: Array, axis: NDArray[np.int64]) -> Array:
    """Return the derivative ``(n, 3)`` of one coordinate of each point by rotations about x, y and
    z; points are ``(n, 3)``, and coordinates are given by ``axis`` ``(n,)``.
    """
    rows = np.arange(len(points))
    return np.stack([np.cross(e, points)[rows, axis] for e in np.eye(3)], axis=1)


def plane_columns(points: Array) -> Array:
    """Return columns ``(n, 3)`` of height and two slopes of a plane at points ``(n, 2+)``."""
    return np.column_stack([np.ones(len(points)), points[:, :2]])


def polynomial_columns(points: Array, degree: int) -> Array:
    """Return the products ``(n, k)`` of powers of x and y up to a degree at points ``(n, 2+)``."""
    x, y = points[:, :2].T
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)


def fit_plane(points: Array, height: Array) -> tuple[Array, Array]:
    """Return the height in the middle and both slopes ``(3, ...)`` of the plane through heights
    ``(n, ...)`` at points ``(n, 2+)``, and the residuals ``(n, ...)``.
    """
    columns = plane_columns(points)
    plane = np.asarray(np.linalg.lstsq(columns, height, rcond=None)[0], dtype=float)
    return plane, height - columns @ plane


@public
@dataclass(frozen=True)
class Geometry:
    """Nominal dimensions, in metres (Pashkevich et al. 2008, section 2.1).

    Attributes:
        L: length of a parallelogram's long bars.
        d: length of its short links.
        r: distance from the tool centre point, or the platform's middle, to each leg's last
            revolute.
        stroke: travel of every carriage from mechanical zero, lower and upper limit.
        layout: where the three legs stand.
    """

    L: float = 0.31025
    d: float = 0.080
    r: float = 0.031
    stroke: tuple[float, float] = field(default=(-0.100, 0.060))
    layout: layouts.Layout = layouts.ORTHOGLIDE

    def __post_init__(self) -> None:
        for name in ("L", "d", "r"):
            value = getattr(self, name)
            if not (isinstance(value, Real) and 0 < float(value) < np.inf):
                raise InputError(f"geometry: {name} must be a positive length, not {value!r}")
            if float(value) > _LARGEST:
                raise InputError(
                    f"geometry: {name} = {value:g} m is far from any machine: give lengths in "
                    f"metres, not millimetres"
                )
        limits = tuple(as_float_array("geometry: the stroke", self.stroke).ravel().tolist())
        if len(limits) != 2 or not self.layout.stroke_fits(self.L, limits):
            raise InputError(
                f"geometry: the stroke's two limits must run from below 0 to above 0 and stay "
                f"within a bar's length, not {self.stroke}"
            )
        object.__setattr__(self, "stroke", limits)
        _ = self.legs  # raises an error where bars are too short

    @cached_property
    def legs(self) -> tuple[layouts.Leg, layouts.Leg, layouts.Leg]:
        """The legs at mechanical zero."""
        return self.layout.legs(self.L, self.r)

    @cached_property
    def slides(self) -> Array:
        """Directions of the legs' rails ``(leg, 3)``."""
        return np.stack([leg.slide for leg in self.legs])

    @cached_property
    def centres(self) -> Array:
        """Centres ``(leg, 3)`` of the spheres on which the TCP lies at mechanical zero, metres."""
        return np.stack([leg.carriage - leg.platform for leg in self.legs])

    @property
    def scale(self) -> float:
        """Factor of the tolerances relative to a machine of a workshop's size: 1 for bars of 150
        to 600 mm, beyond these in proportion to their length.
        """
        return self.L / min(max(self.L, _USUAL_BAR_LENGTHS[0]), _USUAL_BAR_LENGTHS[1])

    @property
    def leg_names(self) -> tuple[str, str, str]:
        """Names of the legs."""
        return self.layout.names.legs

    @property
    def dialled(self) -> bool:
        """Whether dials can be set against its legs: only on the Orthoglide."""
        return self.layout == layouts.ORTHOGLIDE

    @property
    def zero(self) -> Array:
        """Command ``(3,)`` at mechanical zero, where p = 0; the Orthoglide's is (L, L, L)."""
        return np.full(3, self.layout.zero(self.L))

    def commands(self, values: ArrayLike, name: str = "") -> Array:
        """Return ``values`` as commands ``(..., 3)``, metres; messages call them ``name``.

        Raises:
            InputError: for values that are no numbers, have another shape, or are so large that
                they must be millimetres.
        """
        name = name or self.layout.names.command
        rho = vectors(values, name)
        largest = np.abs(rho - self.layout.zero(self.L)).max(initial=0.0)
        if largest - max(map(abs, self.stroke)) > _FAR * self.L:
            raise InputError(
                f"{name}: {np.abs(rho).max():g} m is far from any reach of a machine whose bars "
                f"are {self.L:g} m long: give commands in metres, not millimetres"
            )
        return rho

    def command_on_axis(self, leg: int, travel: ArrayLike) -> Array:
        """Return commands that move the nominal TCP along a base axis (2008, section 2.4).

        Args:
            leg: 0, 1 or 2: the axis.
            travel: metres from mechanical zero, shape ``(...)``.

        Returns:
            Commands rho ``(..., 3)``, metres.

        Raises:
            UnreachableError: where the travel is not less than a bar's length.
            InputError: for any other layout than the Orthoglide.
        """
        if not self.dialled:
            raise InputError(f"legs of a {self.layout.kind} do not lie along base axes")
        along = np.asarray(travel, dtype=float)
        excess = float(np.max(np.abs(along), initial=0.0) - self.L)
        if excess >= 0:
            name = self.leg_names[leg]
            raise UnreachableError(
                f"legs of {self.L * 1e3:g} mm cannot follow the TCP {excess * 1e3:g} mm beyond "
                f"their length along {name}",
                leg=name,
                excess=excess,
            )
        rho = np.repeat(np.sqrt(self.L**2 - along**2)[..., None], 3, axis=-1)
        rho[..., leg] = self.L + along
        return rho

    def command(self, posture: str) -> Array:
        """Return the command ``(3,)`` of a named posture: ``zero``, ``xmax``, ``xmin`` ...

        Raises:
            InputError: for an unknown name.
        """
        ends = [f"{leg}{end}" for leg in LEGS for end in ("min", "max")] if self.dialled else []
        check_choice("posture", posture, ("zero", *ends))
        if posture == "zero":
            return self.zero
        leg, end = divmod(ends.index(posture), 2)
        return self.command_on_axis(leg, self.stroke[end])

    def in_stroke(self, rho: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Return which commands ``rho (..., 3)`` are in the stroke, with ``slack`` metres."""
        travel = np.asarray(rho, dtype=float) - self.layout.zero(self.L)
        return (travel >= self.stroke[0] - slack) & (travel <= self.stroke[1] + slack)
