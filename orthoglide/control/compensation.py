"""Compensation: a path of TCP points into commands, and the accuracy to expect of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.effects import MACHINE_PARAMETERS, is_dial
from orthoglide.errors import ClosureError, InputError, UnreachableError
from orthoglide.geometry import LEGS, Array
from orthoglide.machine import Machine
from orthoglide.mechanism.functions import TCP
from orthoglide.observations.approach import derive_approach
from orthoglide.observations.checks import STROKE_SLACK
from orthoglide.prediction import Conditions

RESOLUTION = 1e-9
"""Metres: commands are rounded to this, the last digit that files show."""

NOT_COVERED = (
    "the place and orientation of the machine as a whole, which leg readings cannot see",
    "effects that the machine file has no parameter for",
    "temperature and load other than those given, and drift since the calibration",
    "scatter from run to run: servo lag, play that follows no rule",
)
"""What the expected accuracy does not cover."""

_ROUNDS = 12

Covariance = tuple[Sequence[str], ArrayLike]
"""Names of machine parameters and their covariance ``(P, P)``, SI; such as ``Estimate`` has."""


@dataclass(frozen=True, eq=False)
class Compensation:
    """Commands for a path, row by row.

    Attributes:
        wanted: TCP points ``(n, 3)``, metres.
        rho: commands as joint coordinates ``(n, 3)``, metres, rounded.
        travel: the same as the controller counts them ``(n, 3)``, metres.
        approach: direction in which each drive arrives ``(n, 3)``, +1 or -1.
        predicted: TCP that the commands reach on this machine ``(n, 3)``, metres.
        uncompensated: TCP ``(n, 3)`` that the nominal machine's commands would reach, metres.
        sigma: standard deviation of the TCP along each base axis ``(n, 3)``, metres, from those
            of the parameters.
        independent: whether the parameters were taken for independent.
    """

    wanted: Array
    rho: Array
    travel: Array
    approach: Array
    predicted: Array
    uncompensated: Array
    sigma: Array
    independent: bool

    def __len__(self) -> int:
        return len(self.wanted)

    @property
    def residual(self) -> Array:
        """Distance of the predicted TCP from the wanted ``(n,)``, metres: rounding alone."""
        return np.linalg.norm(self.predicted - self.wanted, axis=1)

    @property
    def error_before(self) -> Array:
        """Distance by which the nominal machine's commands would miss ``(n,)``, metres."""
        return np.linalg.norm(self.uncompensated - self.wanted, axis=1)

    @property
    def accuracy(self) -> Array:
        """Expected distance from the wanted point, root mean square ``(n,)``, metres."""
        return np.sqrt(np.sum(self.sigma**2, axis=1) + self.residual**2)

    def __str__(self) -> str:
        before, after = self.error_before * 1e3, self.accuracy * 1e3
        how = (
            "from the parameters' sigmas, taken for independent; values that the readings only "
            "see together make this too large"
            if self.independent
            else "from the parameters' covariance"
        )
        lines = [
            f"{len(self)} points: without compensation the TCP would miss by {before.mean():.4f} "
            f"mm on average, {before.max():.4f} mm at most",
            f"with it, expect {np.sqrt(np.mean(after**2)):.4f} mm rms, {after.max():.4f} mm at the "
            f"worst point (one standard deviation, {how})",
            "not covered: " + "; ".join(NOT_COVERED),
        ]
        return "\n".join(lines)


def compensate(
    machine: Machine,
    points: ArrayLike,
    *,
    start: ArrayLike | None = None,
    time: ArrayLike = 0.0,
    warming: ArrayLike = 0.0,
    load: ArrayLike = 0.0,
    covariance: Covariance | None = None,
    resolution: float = RESOLUTION,
) -> Compensation:
    """Commands that bring the TCP to the wanted points, given all the machine's effects.

    Points are taken in their order: a drive's lost motion depends on the direction of its last
    move, which depends on the command; both are settled together.

    Args:
        machine: calibrated.
        points: TCP ``(n, 3)``, metres, in the order in which they are gone through.
        start: TCP ``(3,)`` before the first point; where absent, all drives arrive at it in +.
        time: seconds, a number or ``(n,)``.
        warming: kelvin above the calibration's first reading, a number or ``(n,)``.
        load: newtons at the TCP along base -z, a number or ``(n,)``.
        covariance: of the parameters where it is known; else they are taken for independent.
        resolution: of the commands, metres.

    Raises:
        InputError: for points that are not numbers, or an approach that cannot be settled.
        UnreachableError: naming the row of the first point outside reach or stroke.
    """
    goal = np.asarray(points, dtype=float)
    if goal.ndim != 2 or goal.shape[1] != 3 or not len(goal):
        raise InputError(f"a path has the shape (n, 3), n at least 1, not {goal.shape}")
    bad = np.flatnonzero(~np.isfinite(goal).all(axis=1))
    if bad.size:
        raise InputError(f"row {bad[0] + 1} of the path is not finite: give numbers in metres")
    given = {"time": time, "warming": warming, "load": load}
    seen = {k: np.broadcast_to(np.asarray(v, float), len(goal)) for k, v in given.items()}
    nominal = _nominal_commands(machine, goal)
    before = None if start is None else _nominal_commands(machine, np.reshape(start, (1, 3)))
    rho, approach = _settled(machine, goal, before, seen)
    steps = machine.spec.controller.from_rho(rho, machine.geometry) / resolution
    travel = np.round(np.round(steps) * resolution, 12)
    rho = machine.spec.controller.to_rho(travel, machine.geometry)
    _check_stroke(machine, rho)
    conditions = {"approach": approach, **seen}
    return Compensation(
        goal,
        rho,
        travel,
        approach,
        machine.forward(rho, **conditions),
        machine.forward(nominal, **{**conditions, "approach": _approach(nominal, before)}),
        tcp_sigma(machine, rho, covariance=covariance, **conditions),
        covariance is None,
    )


def tcp_sigma(
    machine: Machine,
    rho: ArrayLike,
    *,
    covariance: Covariance | None = None,
    **seen: ArrayLike,
) -> Array:
    """``sqrt(diag(J C J^T))``: standard deviation of the TCP along each axis, from the parameters'.

    Args:
        machine: whose parameters carry their sigmas.
        rho: commands ``(n, 3)``, metres.
        covariance: see :func:`compensate`.
        seen: conditions, as for ``Machine.pose``.

    Returns:
        ``(n, 3)``, metres.

    Raises:
        InputError: for a covariance that does not fit its names.
    """
    values = {name: v for name, v in machine.values.items() if not is_dial(name)}
    if covariance is None:
        entries = machine.spec.parameters.items()
        known = {n: e.sigma for n, e in entries if n in MACHINE_PARAMETERS and e.sigma > 0}
        names, spread = list(known), np.diag(np.square(list(known.values())))
    else:
        names, spread = _machine_part(covariance)
    commands = np.atleast_2d(np.asarray(rho, dtype=float))
    if not names:
        return np.zeros_like(commands)
    conditions = Conditions.at(commands, **seen)
    _, slopes = machine.model.sensitivities(values, conditions, names)
    slopes = slopes[:, TCP]
    variance = np.einsum("nip,pq,niq->ni", slopes, spread, slopes)
    return np.sqrt(np.maximum(variance, 0.0))


def _machine_part(covariance: Covariance) -> tuple[list[str], Array]:
    names, spread = list(covariance[0]), np.asarray(covariance[1], dtype=float)
    if spread.shape != (len(names), len(names)):
        raise InputError(f"{len(names)} names need a covariance of that many rows and columns")
    kept = [k for k, name in enumerate(names) if not is_dial(name)]
    for k in kept:
        if names[k] not in MACHINE_PARAMETERS:
            raise InputError(f"the covariance names {names[k]!r}, which is no single parameter")
    return [names[k] for k in kept], spread[np.ix_(kept, kept)]


def _nominal_commands(machine: Machine, goal: Array) -> Array:
    return _reached(lambda rows: machine.model.mechanism.inverse(goal[rows]), len(goal))


def _reached(solve: Callable[[slice], Array], count: int) -> Array:
    """Solve for all rows of the path; a failure names its row."""
    try:
        return solve(slice(None))
    except (UnreachableError, ClosureError) as error:
        row = error.index[0] if error.index else 0
        for k in range(0 if error.index else count):  # the error of a batch need not say which
            try:
                solve(slice(k, k + 1))
            except (UnreachableError, ClosureError):
                row = k
                break
        _refuse_reach(error, row)


def _refuse_reach(error: UnreachableError | ClosureError, row: int) -> NoReturn:
    leg = getattr(error, "leg", "")
    excess = float(getattr(error, "excess", 0.0))
    why = f"leg {leg} is {excess * 1e3:.3f} mm too short" if leg else "the legs do not reach it"
    raise UnreachableError(
        f"row {row + 1} of the path is out of reach: {why}; move the point towards the middle",
        leg=leg,
        excess=excess,
        index=(row,),
    ) from error


def _check_stroke(machine: Machine, rho: Array) -> None:
    inside = machine.geometry.in_stroke(rho, STROKE_SLACK)
    if inside.all():
        return
    row, axis = (int(k) for k in np.argwhere(~inside)[0])
    travel, (low, high) = rho[row, axis] - machine.geometry.L, machine.geometry.stroke
    excess = float(max(low - travel, travel - high))
    raise UnreachableError(
        f"row {row + 1} of the path needs carriage {LEGS[axis]} at {travel * 1e3:.3f} mm from "
        f"mechanical zero, {excess * 1e3:.3f} mm beyond its stroke of {low * 1e3:g} to "
        f"{high * 1e3:g} mm: move the point towards the middle",
        leg=LEGS[axis],
        excess=excess,
        index=(row,),
    )


def _approach(rho: Array, before: Array | None) -> Array:
    whole = rho if before is None else np.concatenate([before, rho])
    return derive_approach(whole, np.arange(len(whole)))[len(whole) - len(rho) :]


def _settled(
    machine: Machine, goal: Array, before: Array | None, seen: dict[str, Array]
) -> tuple[Array, Array]:
    """Commands and approaches that belong together."""
    _check_stroke_roughly(machine, goal)
    approach = np.zeros_like(goal)
    rho = _inverse(machine, goal, {**seen, "approach": approach})
    for _ in range(_ROUNDS):
        way = _approach(rho, before)
        if np.array_equal(way, approach):
            return rho, approach
        changed, approach = (way != approach).any(axis=1), way
        rho = _inverse(machine, goal, {**seen, "approach": approach})
    row = int(np.flatnonzero(changed)[0])
    raise InputError(
        f"row {row + 1} of the path has no consistent direction of approach: a lost motion in the "
        f"machine file is negative or longer than any drive's; identify it again"
    )


def _check_stroke_roughly(machine: Machine, goal: Array) -> None:
    """Points far outside the stroke are refused as such, before effects are solved for there."""
    rho, spare = _nominal_commands(machine, goal), 0.02
    if not machine.geometry.in_stroke(rho, spare).all():
        inside = machine.geometry.in_stroke(rho, spare).all(axis=1)
        rho[inside] = machine.geometry.zero
        _check_stroke(machine, rho)


def _inverse(machine: Machine, goal: Array, seen: dict[str, Array]) -> Array:
    return _reached(
        lambda rows: machine.inverse(goal[rows], **{k: v[rows] for k, v in seen.items()}), len(goal)
    )
