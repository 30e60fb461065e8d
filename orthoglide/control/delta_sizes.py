"""Sizes and endstops by which the controller of a linear delta should compute."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from orthoglide.accuracy import drawn_errors, lack_of_gain, tcp_slopes
from orthoglide.effects.plates import PLATE_SHAPE_SD
from orthoglide.geometry import Array, fit_plane
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.prediction import Conditions

_ENDSTOPS, _SIZES = [0, 1, 2], ([3], [4, 5], [6])
"""Columns of a change of the numbers: endstops; radius of all towers; places of towers a and b on
their circle, against c, as a turn of all towers is no error; and length of all arms, which changes
where no other size will do."""

_STEPS = 3  # of Gauss-Newton: a fourth changes nothing
_COMMON_WEIGHT = 1e-2  # of motions that are no error: they decide between equal numbers
_COUNTED = np.array([0.3, 0.3, 1.0])
"""Weights of errors along the plate and of height: a print shows a tenth of a millimetre in height,
half a layer, as it shows three tenths of its width."""

_ARM_SD = 1e-3  # metres, of arms that were entered by a rule or a shop's page
_COUNT = 7  # numbers, which fit as many touches whether they are right or wrong
_MIN_SPREAD = 1 / 6
"""Root mean square of the places, as a share of the towers' radius, in the direction in which they
spread least: that of a disk of a third. Touches of a plate's middle do not determine its rim."""

_MIN_RELATIVE_GAIN = 0.02  # of the tool's error now: a smaller gain is not worth a number


@dataclass(frozen=True)
class DeltaSizes:
    """One consistent set of changes of a controller's numbers, and what they gain."""

    endstops: Array  # how much higher the carriages stand than counted (3,), metres
    arms: float  # change of the length of all arms, metres
    radius: float  # change of the radius of all towers, metres
    shifts: Array  # change of the places of the towers along their circle (3,), metres
    gain: float  # decrease of the tool's weighted error over the plate to expect, rms, metres
    sigma: float  # standard deviation of the gain
    advised: bool  # whether the gain is certain, in height and along the plate


def best_sizes(machine: Machine, campaigns: Iterable[Readings]) -> DeltaSizes | None:
    """Return the numbers for a calibrated delta's controller; ``None`` if touches are too few,
    or do not spread beyond the middle of the plate.

    With them the tool errs least where the plate was touched, which is z = 0. Of the sizes, those
    change that gain most with certainty under the posterior, and as few as gain nearly as much;
    nothing is lost in height or along the plate. If no gain is certain, all change, and none is
    advised.
    """
    touched = [c.subset(np.flatnonzero(c.touching)) for c in campaigns if c.touching.sum() > 2]
    points, plane = _plate(machine, touched) if touched else (np.zeros((1, 3)),) * 2
    _, narrowest, _ = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(points.T, bias=True)), 0.0))
    radius = float(np.hypot(*machine.geometry.centres[0, :2]))
    if len(points) <= _COUNT or narrowest < _MIN_SPREAD * radius:
        return None
    slopes, mean, drawn = _errors(machine, points, plane)

    def fitted(columns: Iterable[list[int]]) -> Array:
        free, change = [*_ENDSTOPS, *(k for c in columns for k in c)], np.zeros(_COUNT)
        change[free] = np.linalg.lstsq(slopes[:, free], mean)[0]
        return change

    now = mean[: 3 * len(points)].reshape(-1, 3)
    size_now, found = _rms(now, drawn), list[tuple[Array, float, float, float]]()
    for columns in [c for count in range(4) for c in combinations(_SIZES, count)]:
        left = mean - slopes @ (change := fitted(columns))
        after = left[: 3 * len(points)].reshape(-1, 3)
        # The decrease of the square of each error, which is linear in the deviations drawn.
        less = np.mean(now**2 - after**2 + 2 * drawn * (now - after), axis=1)
        height, along = less[:, 2], less[:, :2].sum(axis=1)
        rms = size_now + _rms(after, drawn)
        gain, sigma = (float(v / rms) for v in ((height + along).mean(), (height + along).std()))
        loses = any(part.mean() < -part.std() for part in (height, along))
        certain = -np.inf if loses or lack_of_gain(gain, sigma) else gain - 2 * sigma
        found.append((change, gain, sigma, float(certain)))
    least = max(x[-1] for x in found) - _MIN_RELATIVE_GAIN * size_now
    advised = least > 0
    change, gain, sigma, _ = next(x for x in found if x[-1] > least) if advised else found[-1]
    shifts, (wider, arms) = np.append(change[4:6], -change[4:6].sum()), change[[3, 6]].tolist()
    endstops, shifts = (part - np.median(part) for part in (change[:3], shifts))
    return DeltaSizes(endstops, arms, wider, shifts, gain, sigma, advised)


def _rms(errors: Array, drawn: Array) -> float:
    """Return the root mean square of errors ``(n, 3)`` with deviations ``(draws, n, 3)``."""
    return float(np.sqrt(np.mean(np.sum((errors + drawn) ** 2, axis=-1))))


def _plate(machine: Machine, touched: Iterable[Readings]) -> tuple[Array, Array]:
    """Return points at z = 0 where a plate was touched, and the plane of the touches there, as
    displacements; both ``(n, 3)``, metres. The mean height of every list is subtracted.
    """
    parts = list[Array]()
    for touches in touched:
        pose, beside = machine.pose(touches.command), np.array([s.beside for s in touches.setups])
        p = pose.p + np.einsum("nij,nj->ni", pose.R, beside[touches.setup])
        p[:, 2] -= touches.reading
        parts.append(p - p.mean(axis=0) * [0.0, 0.0, 1.0])
    p = np.concatenate(parts)
    height = np.outer(p[:, 2] - fit_plane(p, p[:, 2])[1], [0.0, 0.0, 1.0])
    return p * [1.0, 1.0, 0.0], height


def _errors(machine: Machine, points: Array, plane: Array) -> tuple[Array, Array, Array]:
    """Return the tool's weighted errors at points of a plate: slopes ``(3 n + 4, 7)``, mean
    ``(3 n + 4,)``, and deviations of machines drawn from the posterior ``(draws, 3 n)``, metres.

    Whatever the machine, its touches determine the slopes of the plate. Neither a common height nor
    a shift or turn along the plate is an error: they stand in the last four rows alone.
    """
    zero, arm, place = (
        machine.catalogue.correctable_by(x)[0] for x in ("zero", "bar_length", "place")
    )
    a, b, c = legs = machine.geometry.leg_names
    columns = [{f"{zero}.{leg}": 1.0} for leg in legs]
    columns += [{f"{place}.{leg}.radial": 1.0 for leg in legs}]
    columns += [{f"{place}.{x}.tangential": 1.0, f"{place}.{c}.tangential": -1.0} for x in (a, b)]
    columns += [{f"{arm}.{leg}": 1.0 for leg in legs}]
    names = tuple(dict.fromkeys(name for column in columns for name in column))
    matrix = np.array([[column.get(name, 0.0) for column in columns] for name in names])
    motions = np.zeros((6, len(points), 3))  # of the whole machine; the last two tilt the plate
    motions[[0, 1, 2], :, [0, 1, 2]] = 1.0
    motions[3:] = np.cross(np.eye(3)[::-1, None], points)
    rigid, change = np.linalg.qr(motions.reshape(6, -1).T)[0], np.zeros(_COUNT)
    level = rigid[:, :4]
    for _ in range(_STEPS):
        settings = dict(zip(names, (matrix @ change).tolist(), strict=True))
        commands = machine.with_only(settings).inverse(points)
        by_name = tcp_slopes(machine, names, Conditions.from_commands(commands))
        error = (machine.forward(commands) - points - plane).ravel()
        slopes, mean = (
            np.concatenate([v - level @ (level.T @ v), _COMMON_WEIGHT * level.T @ v])
            for v in ((by_name @ matrix).reshape(-1, _COUNT), error)
        )
        mean = mean + slopes @ change  # of the old numbers
        change = np.linalg.lstsq(slopes, mean)[0]
    drawn = drawn_errors(machine, commands, points + plane).reshape(-1, error.size) - error
    drawn = drawn - drawn @ rigid @ rigid.T
    # Arms that were entered wrong and a bowl look like another radius: only heights are known then.
    open_fields = np.zeros((error.size, 2))
    open_fields[:, 0] = slopes[: error.size, 6] * _ARM_SD * (machine.spec.measured.rods is None)
    open_fields[2::3, 1] = PLATE_SHAPE_SD * np.sum(points**2, axis=1) / np.max(points**2)
    by_others = np.linalg.lstsq(slopes[2 : error.size : 3, :4], open_fields[2::3])[0]
    open_fields -= slopes[: error.size, :4] @ by_others
    open_fields[2::3] = 0.0
    drawn += np.random.default_rng(1).standard_normal((len(drawn), 2)) @ open_fields.T
    weight = np.append(np.tile(_COUNTED, len(points)), np.ones(4))
    return weight[:, None] * slopes, weight * mean, _COUNTED * drawn.reshape(len(drawn), -1, 3)
