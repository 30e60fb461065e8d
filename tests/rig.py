"""The independent machine of the tests: a rigid platform on six bars, with numpy alone.

Carriage i holds the carriage ends ``A`` of two bars, the platform their other ends ``p + R b``; the
pose (p, R) is where all six distances equal the bars' lengths. Nothing here comes from the package:
this is a third derivation of the machine, beside its mechanism and its analytic reduction.

SI units throughout. Leg i (0, 1, 2 for x, y, z) has the axes a = e_i, b = e_(i+1), c = e_(i+2),
cyclic. Bar 1 is on the +c side of the short link. ``errors`` takes the parameter names of the
campaign format, one value a name ("axis_tilt.y.z", "backlash.x", "gauge_scale.<setup>" ...).

Definitions where a name alone leaves second-order terms open:

- the carriage turns about a, then about the turned b, then about the turned c; rail_tilt and
  mount_tilt about the same axis add up;
- every effect on the path uses the true travel, the give of the drive under load included;
- the force on a drive is taken along its carriage's path in the loaded pose, F . dp/d(true travel).

Left out: the torsional stiffness of a leg. Six bars on ball joints carry no torsion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Extra = Callable[[Array, Array, Array], Array]
"""(true travel (N, 3), approach (N, 3), time (N,)) -> displacement (N, 3 legs, 3 base axes)."""

LEGS = "xyz"
BASE = np.eye(3)
ON_LEG = (
    "joint_offset", "leg_length", "bar_mismatch", "parallelogram_width", "encoder_scale",
    "backlash", "drive_compliance", "thermal_growth", "thermal_drift",
)  # fmt: skip
ON_LEG_AND_AXIS = ("axis_offset", "axis_tilt", "rail_tilt", "rail_bow")
ON_DIAL = ("gauge_scale", "gauge_direction", "gauge_drift")

TOLERANCE = {
    "joint_offset": 2e-3, "leg_length": 5e-5, "axis_tilt": 1e-3, "axis_offset": 3e-4,
    "mount_tilt": 2e-3, "bar_mismatch": 5e-5, "parallelogram_width": 1e-4, "rail_bow": 2e-5,
    "rail_tilt": 1e-3, "encoder_scale": 1e-4, "screw_error": 1e-5, "backlash": 2e-5,
    "thermal_growth": 5e-6, "gauge_scale": 0.01, "gauge_direction": 0.02, "gauge_drift": 2e-8,
}  # fmt: skip
"""Standard deviation to expect of each family, SI."""


class RigError(RuntimeError):
    """The rig has no such parameter, or its pose was not found."""


class Pose(NamedTuple):
    """Where the machine stands in N conditions.

    Attributes:
        p: TCP ``(N, 3)``, metres, base frame.
        R: rotation of the platform ``(N, 3, 3)``, base from platform.
        lines: ends of the bars ``(N, leg, bar, end, 3)``, metres, base frame; end 0 on the
            carriage, end 1 on the platform.
    """

    p: Array
    R: Array
    lines: Array


def parameter_names(setups: Sequence[str] = ()) -> Iterator[str]:
    """Every parameter of a rig, those of the dial for the setups given."""
    for leg, name in enumerate(LEGS):
        yield from (f"{family}.{name}" for family in ON_LEG)
        others = [LEGS[j] for j in range(3) if j != leg]
        yield from (f"{family}.{name}.{j}" for family in ON_LEG_AND_AXIS for j in others)
        yield from (f"mount_tilt.{name}.a", f"mount_tilt.{name}.b")
        yield from (f"screw_error.{name}.sin", f"screw_error.{name}.cos")
    yield from (f"{family}.{setup}" for family in ON_DIAL for setup in setups)


@dataclass(frozen=True)
class Rig:
    """A machine with its errors.

    Attributes:
        L, d, r: bar length, short link, distance from the TCP to each leg's attachment; metres.
        stroke: travel from mechanical zero, lower and upper limit, metres.
        errors: parameter name to value, SI.
        screw_pitch: lead of the drives' screws, metres.
        bar_stiffness: of one bar, N/m; 0 for rigid bars.
        extra: displacements of the carriages that have no parameter.
        extra_platform: the same of the legs' attachments, in the platform's axes.
        extra_turn: turns of the carriages about their centres, rotation vectors ``(N, 3, 3)``.
        extra_length: what the bars are longer by ``(N, 3, 2)``.
        extra_dial: by setup, what its dial shows too much at a reading since its first.
    """

    L: float = 0.31025
    d: float = 0.08
    r: float = 0.031
    stroke: tuple[float, float] = (-0.1, 0.06)
    errors: Mapping[str, float] = field(default_factory=dict)
    screw_pitch: float = 0.02
    bar_stiffness: float = 0.0
    extra: tuple[Extra, ...] = ()
    extra_platform: tuple[Extra, ...] = ()
    extra_turn: tuple[Extra, ...] = ()
    extra_length: tuple[Extra, ...] = ()
    extra_dial: Mapping[str, Callable[[Array], Array]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = set(parameter_names())
        for name in self.errors:
            family, _, setup = name.partition(".")
            if name not in known and not (family in ON_DIAL and setup):
                raise RigError(f"the rig has no parameter {name!r}")

    def error(self, name: str) -> float:
        """Value of a parameter, 0 where it is not set."""
        return float(self.errors.get(name, 0.0))

    def by_leg(self, family: str, member: str = "") -> Array:
        """The three legs' values of a family, ``(3,)``."""
        return np.array([self.error(f"{family}.{leg}{member}") for leg in LEGS])

    def by_axis(self, family: str) -> Array:
        """Values of a family by leg and base axis, ``(3, 3)``, 0 along the leg's own axis."""
        return np.array([[self.error(f"{family}.{i}.{j}") for j in LEGS] for i in LEGS])

    def with_errors(self, errors: Mapping[str, float]) -> Rig:
        """The same rig with these errors set, in addition to or instead of its own."""
        return replace(self, errors={**self.errors, **errors})

    def with_background(
        self, rng: np.random.Generator, scale: float, setups: Sequence[str] = ()
    ) -> Rig:
        """Small errors of everything that is not set: N(0, scale x tolerance)."""
        drawn = {
            name: scale * TOLERANCE[name.partition(".")[0]] * float(rng.standard_normal())
            for name in parameter_names(setups)
            if name.partition(".")[0] in TOLERANCE
        }
        return replace(self, errors={**drawn, **self.errors})

    # -- from conditions to bar ends ---------------------------------------------------------

    def _unloaded_travel(self, commands: Array, approach: Array) -> Array:
        """True travel ``(N, 3)`` before anything gives way under the load."""
        told = commands - self.L
        phase = 2 * np.pi * told / self.screw_pitch
        screw = self.by_leg("screw_error", ".sin") * np.sin(phase)
        screw += self.by_leg("screw_error", ".cos") * np.cos(phase)
        scale = 1 + self.by_leg("encoder_scale")
        lag = self.by_leg("backlash") / 2 * approach
        return told * scale + self.by_leg("joint_offset") + screw - lag

    def _path(self, travel: Array) -> tuple[Array, Array]:
        """Carriage centres ``(N, 3, 3)`` and their derivative by the travel."""
        middle, half = np.mean(self.stroke), np.ptp(self.stroke) / 2
        u = ((travel - middle) / half)[..., None]
        s = travel[..., None]
        slope = self.by_axis("axis_tilt") + self.by_axis("rail_tilt")
        bow = self.by_axis("rail_bow")
        along = (self.L + self.r + s) * BASE
        centre = along + self.by_axis("axis_offset") + slope * s + bow * (u**2 - 1)
        return centre, BASE + slope + bow * 2 * u / half

    def _short_links(self) -> tuple[Array, Array]:
        """Half short links, from centre to bar 1: on the carriages and on the platform."""
        carriage, platform = np.zeros((3, 3)), np.zeros((3, 3))
        rail, width = self.by_axis("rail_tilt"), self.by_leg("parallelogram_width")
        for leg in range(3):
            a, b, c = BASE[leg], BASE[(leg + 1) % 3], BASE[(leg + 2) % 3]
            turn = sum((rail[leg, j] * np.cross(a, BASE[j]) for j in range(3)), np.zeros(3))
            turn += self.error(f"mount_tilt.{LEGS[leg]}.a") * a
            turn += self.error(f"mount_tilt.{LEGS[leg]}.b") * b
            R = rotation(a * (a @ turn)) @ rotation(b * (b @ turn)) @ rotation(c * (c @ turn))
            carriage[leg], platform[leg] = R @ c * self.d / 2, c * (self.d + width[leg]) / 2
        return carriage, platform

    def _lengths(self, time: Array, temperature_rise: Array) -> Array:
        """Lengths of the unloaded bars ``(N, leg, bar)``."""
        growth = temperature_rise[:, None] * self.by_leg("thermal_growth")
        growth = growth + time[:, None] * self.by_leg("thermal_drift")
        mean = (self.L + self.by_leg("leg_length")) * (1 + growth)
        half = self.by_leg("bar_mismatch") / 2
        return np.stack([mean + half, mean - half], axis=-1)

    def pose(
        self,
        commands: ArrayLike,
        approach: ArrayLike = 0.0,
        time: ArrayLike = 0.0,
        temperature_rise: ArrayLike = 0.0,
        load: ArrayLike = 0.0,
    ) -> Pose:
        """Pose and bars in N conditions: |A_k - p - R b_k| = l_k for the six bars k.

        Under a load the bar tensions t follow from the platform's equilibrium; bars give t / k and
        drives give their compliance times the force along the path, to a fixed point. That is the
        least of the springs' energy minus the work of the load.

        Args:
            commands: rho ``(N, 3)``, metres.
            approach: direction of each axis' last move ``(N, 3)``, +1, -1 or 0 (unknown).
            time: seconds ``(N,)``.
            temperature_rise: kelvin since the first reading ``(N,)``.
            load: newtons at the TCP along base -z ``(N,)``.

        Raises:
            RigError: the bars do not reach, or the pose was not found to 1e-13 m.
        """
        rho = np.atleast_2d(np.asarray(commands, dtype=float))
        n = len(rho)
        near = np.broadcast_to(np.asarray(approach, dtype=float), (n, 3))
        clock, heat, weight = (
            np.broadcast_to(np.asarray(x, dtype=float), (n,))
            for x in (time, temperature_rise, load)
        )
        free_travel, free_length = self._unloaded_travel(rho, near), self._lengths(clock, heat)
        free_length = sum((e(free_travel, near, clock) for e in self.extra_length), free_length)
        carriage, half_width = self._short_links()
        travel, length = free_travel, free_length
        for _ in range(30):
            centre, path = self._path(travel)
            attach = np.broadcast_to(BASE * self.r, (n, 3, 3))
            centre = sum((e(travel, near, clock) for e in self.extra), centre)
            attach = sum((e(travel, near, clock) for e in self.extra_platform), attach)
            half_link = np.broadcast_to(carriage, (n, 3, 3))
            for turn in self.extra_turn:
                half_link = np.einsum(
                    "nlij,nlj->nli", rotation(turn(travel, near, clock)), half_link
                )
            A = np.stack([centre + half_link, centre - half_link], axis=2)
            b = np.stack([attach + half_width, attach - half_width], axis=2)
            p, R = _solve(A.reshape(n, 6, 3), b.reshape(n, 6, 3), length.reshape(n, 6), travel)
            B = p[:, None, None] + np.einsum("nij,nlbj->nlbi", R, b)
            if not weight.any():
                break
            pull = _tensions(A, B, p, weight)
            force = np.einsum("nlbi,nli->nl", pull, path)
            tension = np.einsum("nlbi,nlbi->nlb", pull, _unit(B - A))
            give = tension / self.bar_stiffness if self.bar_stiffness else 0.0
            before = np.concatenate([travel.ravel(), length.ravel()])
            travel = free_travel + self.by_leg("drive_compliance") * force
            length = free_length + give
            if np.abs(np.concatenate([travel.ravel(), length.ravel()]) - before).max() < 1e-14:
                break
        else:
            raise RigError("the loaded pose was not found: the load or the compliance is too large")
        return Pose(p, R, np.stack([A, B], axis=3))

    # -- what a dial shows -------------------------------------------------------------------

    def readings(
        self,
        lines: Array,
        leg: ArrayLike,
        direction: Sequence[str],
        gauge: ArrayLike,
        bar: ArrayLike = 0,
        setup: Sequence[str] = (),
        time: ArrayLike = 0.0,
    ) -> Array:
        """Dial readings ``(N,)`` in metres, the datum left out.

        sign (1 + scale) [cos(g) e_dir + sin(g) (a x e_dir)] . X + drift t, where X is the touched
        line's crossing with the plane own coordinate = gauge + r.

        Args:
            lines: of the poses, ``(N, leg, bar, end, 3)``.
            leg: 0, 1 or 2, ``(N,)``.
            direction: "y", "-z" ..., N of them.
            gauge: place of the dial along the leg, r removed, metres ``(N,)``.
            bar: 1 or 2, or 0 for the median line, ``(N,)``.
            setup: names of the mountings, N of them, for the dial's errors.
            time: seconds ``(N,)``.
        """
        rows, own = np.arange(len(lines)), np.asarray(leg)
        touched = np.broadcast_to(np.asarray(bar), rows.shape)
        both = lines[rows, own]  # (N, bar, end, 3)
        one = both[rows, np.maximum(touched, 1) - 1]
        line = np.where((touched == 0)[:, None, None], both.mean(axis=1), one)
        start, run = line[:, 0], line[:, 1] - line[:, 0]
        X = (
            start
            + run * ((np.asarray(gauge) + self.r - start[rows, own]) / run[rows, own])[:, None]
        )
        sign = np.array([-1.0 if d.startswith("-") else 1.0 for d in direction])
        e = BASE[[LEGS.index(d[-1]) for d in direction]]
        scale, angle, drift = (
            np.array([self.error(f"{family}.{s}") for s in setup]) if setup else np.zeros(len(rows))
            for family in ON_DIAL
        )
        stem = np.cos(angle)[:, None] * e + np.sin(angle)[:, None] * np.cross(BASE[own], e)
        shown = sign * (1 + scale) * np.einsum("ni,ni->n", stem, X) + drift * np.asarray(time)
        for name, curve in self.extra_dial.items():
            of = np.array([s == name for s in setup])
            if of.any():
                shown[of] += curve(shown[of] - shown[of][0])
        return shown


def rotation(vector: Array) -> Array:
    """Rotation matrices ``(..., 3, 3)`` of rotation vectors ``(..., 3)`` (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    K = np.swapaxes(np.cross(vector[..., None, :], BASE), -1, -2)  # column j: vector x e_j
    half = np.sinc(angle / (2 * np.pi))  # sin(angle / 2) / (angle / 2)
    return BASE + np.sinc(angle / np.pi) * K + half**2 / 2 * K @ K


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _solve(A: Array, b: Array, length: Array, start: Array) -> tuple[Array, Array]:
    """Newton on the six bars' lengths: A, b ``(N, 6, 3)``, length ``(N, 6)``, start ``(N, 3)``."""
    p, R = start.copy(), np.broadcast_to(BASE, (len(A), 3, 3)).copy()
    for _ in range(30):
        arm = np.einsum("nij,nkj->nki", R, b)
        bar = p[:, None] + arm - A
        n = _unit(bar)
        residual = np.linalg.norm(bar, axis=-1) - length
        step = -np.linalg.solve(np.concatenate([n, np.cross(arm, n)], -1), residual[..., None])
        step = step[..., 0]
        if np.abs(residual).max() < 1e-13 and np.abs(step).max() < 1e-12:
            break
        p, R = p + step[:, :3], rotation(step[:, 3:]) @ R
    else:
        raise RigError("the six bars do not meet the platform")
    # The machine's own assembly mode: bars run toward -a, and their mean directions, legs x, y, z,
    # make a left-handed triple as at mechanical zero (-e_x, -e_y, -e_z).
    mean = (n[:, 0::2] + n[:, 1::2]) / 2
    if (mean[:, range(3), range(3)] > 0).any() or (np.linalg.det(mean) > 0).any():
        raise RigError("the six bars close in another assembly mode")
    return p, R


def _tensions(A: Array, B: Array, p: Array, load: Array) -> Array:
    """Pull of each bar on its carriage, ``(N, leg, bar, 3)``, in newtons.

    The platform rests: sum of pulls = load, and their moments about the TCP cancel.
    """
    n = len(A)
    along = _unit(B - A).reshape(n, 6, 3)
    moment = np.cross((B - p[:, None, None]).reshape(n, 6, 3), along)
    wrench = np.concatenate([load[:, None] * [0.0, 0.0, -1.0], np.zeros((n, 3))], axis=-1)
    balance = np.swapaxes(np.concatenate([along, moment], -1), -1, -2)
    size = np.linalg.solve(balance, wrench[..., None])
    return (size * along).reshape(n, 3, 2, 3)
