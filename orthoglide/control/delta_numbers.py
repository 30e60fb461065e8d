"""Numbers by which the controller of a calibrated linear delta should compute, and their gain.

A controller computes places of the tool from commands, by its equations and numbers. Commands that
take the calibrated machine to places on the plate are fixed, and the numbers are fitted so that the
controller computes these places. The difference that remains is the tool's error, to first order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from orthoglide.accuracy import drawn_errors, lack_of_gain
from orthoglide.effects.plates import PLATE_BOW
from orthoglide.geometry import Array, fit_plane
from orthoglide.machine import Machine
from orthoglide.numerals import with_sigma
from orthoglide.observations import Readings

ENDSTOPS, RADIUS, TOWERS, ARMS = [0, 1, 2], [3], [4, 5], [6]
"""Columns of a change of the numbers: endstops; radius of all towers; displacement of towers a and
b along their circle (c is fixed, as a turn of all towers is no error); length of all arms. The last
two of `NUMBER_COUNT` are additional lengths of arms a and b."""

NUMBER_COUNT = 9
_FITTED_COUNT = 7  # numbers, which fit any seven touches exactly
_STEPS = 4  # of Gauss-Newton with constant derivatives: a fifth changes less than a micrometre
_DIFFERENCE = 1e-6  # metres and radians: derivatives by central differences err by less than 1e-8
_COMMON_WEIGHT = 1e-3  # of rigid motions: small, to select among equally good numbers
_ALONG_WEIGHT = 0.3
"""Weight of errors along the plate against those of height, of sizes that an owner enters: a print
shows an error of a tenth of a millimetre in height, half a layer, as clearly as one of three tenths
along the plate."""

_ARM_SD = 1e-3  # metres, of arms that were entered by a rule or a shop's page
_MIN_SPREAD = 1 / 6
"""Root mean square of the places, as a share of the towers' radius, in the direction in which they
spread least: that of a uniform disk of a third of it. Touches of a plate's middle do not determine
its rim."""

_MIN_RELATIVE_GAIN = 0.02  # of the tool's error now: a smaller gain is not worth a number

Computes = Callable[[Array, Array], Array]
"""Places ``(n, 3)`` that a controller computes if its numbers change by ``(9,)``, metres or radians
in the order of the columns above, for commands ``(n, 3)``."""


class Fit(NamedTuple):
    """A change of the numbers ``(9,)``, and the tool's errors ``(n, 3)`` with it, metres."""

    change: Array
    error: Array


class Gain(NamedTuple):
    """Expected decreases of the tool's error over the plate, rms, each with its standard deviation,
    metres.
    """

    weighted: tuple[float, float]
    height: tuple[float, float]
    along: tuple[float, float]  # along the plate, without the weight
    present: float  # weighted error with the present numbers, metres

    @property
    def lack(self) -> str:
        """Why the new numbers should not be entered, a clause; empty if they should."""
        if reason := lack_of_gain(*self.weighted):
            return reason
        for (gain, sigma), where in ((self.along, "along the plate"), (self.height, "in height")):
            if gain < -sigma:
                size = with_sigma(-gain * 1e3, sigma * 1e3)
                return f"the tool is expected to err by {size} mm more {where}"
        return ""


class PlateErrors:
    """Errors of a calibrated delta over its plate, by the numbers of its controller.

    A shift or turn along the plate is no error, and nor is a common height unless ``has_height``.
    Deviations are those of machines drawn from the posterior, without rigid motions, as z = 0 is
    the plane of each machine's own touches. What unmeasured arms or a bowl of the plate would do
    along the plate is added to them.

    Args:
        machine: calibrated machine.
        computes: equations of the controller.
        places: where the controller is to believe the tool ``(n, 3)``, at z = 0, metres.
        plane: height of the plate over z = 0 there ``(n,)``, metres.
        along_weight: weight of errors along the plate against those of height.
        has_height: whether the touches determine the height of the plate.
        arms_seen: see `arms_are_seen`.
    """

    def __init__(
        self, machine: Machine, computes: Computes, places: Array, plane: Array,
        along_weight: float, has_height: bool, arms_seen: bool,
    ) -> None:  # fmt: skip
        self._computes, self._places = computes, places
        self._bowl = machine.spec.tolerance[PLATE_BOW.name]
        self._weights = np.array([along_weight, along_weight, 1.0])
        wanted = places + np.outer(plane, [0.0, 0.0, 1.0])
        self._commands = machine.inverse(wanted)
        motions = np.zeros((6, len(places), 3))  # of the whole machine; the last two tilt it
        motions[[0, 1, 3], :, [0, 1, 2]] = 1.0
        motions[[2, 4, 5]] = np.cross(np.eye(3)[[2, 0, 1], None], places)
        rigid = np.linalg.qr(motions.reshape(6, -1).T)[0]
        self._level, change = rigid[:, : 3 if has_height else 4], np.zeros(NUMBER_COUNT)
        for _ in range(2):  # derivatives of the computed places (3 n, 9), finally at the fit
            self._slopes = np.stack([
                (self.error(change - e) - self.error(change + e)).ravel() / (2 * _DIFFERENCE)
                for e in _DIFFERENCE * np.eye(NUMBER_COUNT)
            ], axis=1)  # fmt: skip
            change = self.fit([*ENDSTOPS, *RADIUS, *TOWERS, *ARMS]).change
        drawn = drawn_errors(machine, self._commands, wanted).reshape(-1, places.size)
        drawn = drawn - drawn @ rigid @ rigid.T
        independent = np.random.default_rng(1)  # of the draws of `drawn_errors`
        drawn += independent.standard_normal((len(drawn), 2)) @ self._unseen(arms_seen).T
        self._deviations = drawn.reshape(-1, *places.shape)

    def error(self, change: Array) -> Array:
        """Return errors of the tool ``(n, 3)`` with numbers changed by ``(9,)``, metres."""
        return self._places - self._computes(change, self._commands)

    def fit(self, free: Sequence[int], start: Array | None = None) -> Fit:
        """Return the numbers with the least weighted error if those of the columns ``free`` may
        change from a start ``(9,)``.
        """
        change = np.zeros(NUMBER_COUNT) if start is None else start.copy()
        for _ in range(_STEPS):
            error = self.error(change)
            change[free] += np.linalg.lstsq(
                self._rows(self._slopes[:, free]), self._rows(error.reshape(-1, 1))[:, 0]
            )[0]
        return Fit(change, self.error(change))

    def _rows(self, columns: Array) -> Array:
        """Return weighted columns of errors ``(3 n, m)``, and below them those of rigid motions."""
        weighted = np.tile(self._weights, len(self._places))[:, None] * self._leveled(columns)
        return np.vstack([weighted, _COMMON_WEIGHT * self._level.T @ columns])

    def gain(self, before: Array, after: Array) -> Gain:
        """Return the decrease of the tool's error from the present numbers to new ones, given its
        errors ``(n, 3)`` with each.
        """
        leveled = (self._leveled(e.reshape(-1, 1)).reshape(-1, 3) for e in (before, after))
        squares = [np.mean((e + self._deviations) ** 2, axis=1) for e in leveled]  # (draws, 3)

        def part(weights: Array) -> tuple[float, float]:
            decrease = np.subtract(*(np.sqrt(s @ weights) for s in squares))
            return float(decrease.mean()), float(decrease.std())

        up, weights = np.array([0.0, 0.0, 1.0]), self._weights**2
        present = float(np.sqrt(np.mean(squares[0] @ weights)))
        return Gain(part(weights), part(up), part(1 - up), present)

    def _leveled(self, columns: Array) -> Array:
        """Return columns of errors ``(3 n, m)`` without the rigid motions that are no error."""
        return np.asarray(columns - self._level @ (self._level.T @ columns))

    def _unseen(self, arms_seen: bool) -> Array:
        """Return errors along the plate ``(3 n, 2)`` that no touch shows, metres: endstops and
        radius compensate what wrong arms or a bowl of the plate do to heights.
        """
        slopes = self._leveled(self._slopes)
        unseen = np.zeros((len(slopes), 2))
        unseen[:, 0] = slopes[:, 6] * _ARM_SD * (not arms_seen)
        squares = np.sum(self._places**2, axis=1)
        unseen[2::3, 1] = self._bowl * squares / np.max(squares)
        unseen -= slopes[:, :4] @ np.linalg.lstsq(slopes[2::3, :4], unseen[2::3])[0]
        unseen[2::3] = 0.0
        return unseen


def reach_rim(places: Array, radius: float) -> bool:
    """Return whether places ``(n, 2+)`` spread far enough to determine the rim of a plate, relative
    to the radius of the towers, metres.
    """
    if len(places) < 3:
        return False
    spread = np.linalg.eigvalsh(np.cov(places[:, :2].T, bias=True))[0]
    return bool(spread >= (_MIN_SPREAD * radius) ** 2)


def arms_are_seen(machine: Machine, campaigns: Iterable[Readings]) -> bool:
    """Return whether the rods were measured, or distances along the plate show their length."""
    return machine.spec.measured.rods is not None or any(c.paired.any() for c in campaigns)


@dataclass(frozen=True)
class DeltaSizes:
    """One consistent set of changes of a controller's numbers, and what they gain."""

    # height of each carriage over its counted height, relative to the middle one (3,), metres
    endstops: Array
    arms: float  # change of the length of all arms, metres
    radius: float  # change of the radius of all towers, metres
    shifts: Array  # change of the places of the towers along their circle (3,), metres
    gain: float  # decrease of the tool's weighted error over the plate to expect, rms, metres
    sigma: float  # standard deviation of the gain
    advised: bool  # whether the set is to be entered, by the rule of `best_sizes`
    # why not even commands that correct all errors are sure to improve the tool, a clause; or empty
    compensation_lack: str


def best_sizes(machine: Machine, campaigns: Sequence[Readings]) -> DeltaSizes | None:
    """Return the numbers for a calibrated delta's controller; ``None`` if touches are too few,
    or do not spread beyond the middle of the plate.

    Each subset of the sizes is fitted together with the endstops, so that the tool errs least where
    the plate was touched, which is z = 0. Its score is the gain less two standard deviations; a
    subset does not count if the error in height or along the plate rises by more than one standard
    deviation. Of the subsets whose score is within 2 % of the present error of the best score, the
    one with the fewest sizes is returned. If no score exceeds 2 %, the fit of all sizes is returned
    and not advised.
    """
    touched = [c.subset(np.flatnonzero(c.touching)) for c in campaigns if c.touching.sum() > 2]
    points = np.concatenate([np.zeros((0, 3)), *(_touched_places(machine, t) for t in touched)])
    radius = float(np.hypot(*machine.geometry.centres[0, :2]))
    if len(points) <= _FITTED_COUNT or not reach_rim(points, radius):
        return None
    plane = points[:, 2] - fit_plane(points, points[:, 2])[1]
    computes, arms_seen = _sized_controller(machine), arms_are_seen(machine, campaigns)
    places = points * [1.0, 1.0, 0.0]
    errors = PlateErrors(machine, computes, places, plane, _ALONG_WEIGHT, False, arms_seen)
    now, sets = errors.error(np.zeros(NUMBER_COUNT)), list[tuple[float, Array, Gain]]()
    # Lobes of a plate look like other rods, so touches alone do not change these.
    sizes = (RADIUS, TOWERS, ARMS) if arms_seen else (RADIUS, TOWERS)
    for columns in [c for n in range(len(sizes) + 1) for c in combinations(sizes, n)]:
        fit = errors.fit([*ENDSTOPS, *(k for c in columns for k in c)])
        gain = errors.gain(now, fit.error)
        score = -np.inf if gain.lack else gain.weighted[0] - 2 * gain.weighted[1]
        sets.append((score, fit.change, gain))
    least = max(score for score, *_ in sets) - _MIN_RELATIVE_GAIN * gain.present
    advised = least > 0
    _, change, gain = next(s for s in sets if s[0] > least) if advised else sets[-1]
    # A common height or turn is no error: the middle one keeps its value.
    a, b = change[TOWERS]
    endstops, shifts = (v - np.median(v) for v in (change[ENDSTOPS], np.array([a, b, -a - b])))
    arms, wider = float(change[6]), float(change[3])
    lack = errors.gain(now, 0 * now).lack
    return DeltaSizes(endstops, arms, wider, shifts, *gain.weighted, advised, lack)


def _touched_places(machine: Machine, touches: Readings) -> Array:
    """Return the places ``(n, 3)`` where a plate was touched, metres; heights have mean zero."""
    pose, beside = machine.pose(touches.command), np.array([s.beside for s in touches.setups])
    p = pose.p + np.einsum("nij,nj->ni", pose.R, beside[touches.setup])
    p[:, 2] -= touches.reading
    return np.asarray(p - p.mean(axis=0) * [0.0, 0.0, 1.0])


def _sized_controller(machine: Machine) -> Computes:
    """Return the equations of a controller that knows endstops, radius, places and arms."""
    zero, arm, place = (
        machine.catalogue.correctable_by(x)[0] for x in ("zero", "bar_length", "place")
    )
    a, b, c = legs = machine.geometry.leg_names
    columns = [{f"{zero}.{leg}": 1.0} for leg in legs]
    columns += [{f"{place}.{leg}.radial": 1.0 for leg in legs}]
    columns += [{f"{place}.{x}.tangential": 1.0, f"{place}.{c}.tangential": -1.0} for x in (a, b)]
    columns += [{f"{arm}.{leg}": 1.0 for leg in kept} for kept in (legs, (a,), (b,))]
    names = tuple(dict.fromkeys(name for column in columns for name in column))
    matrix = np.array([[column.get(name, 0.0) for column in columns] for name in names])

    def computes(change: Array, commands: Array) -> Array:
        settings = dict(zip(names, (matrix @ change).tolist(), strict=True))
        return machine.with_only(settings).forward(commands)

    return computes
