"""Sizes and endstops by which the controller of a linear delta should compute."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from orthoglide.accuracy import drawn_errors, lack_of_gain, tcp_slopes
from orthoglide.effects.plates import PLATE_SHAPE_SD
from orthoglide.geometry import Array, fit_plane
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.prediction import Conditions

_ENDSTOPS, _SIZES = [0, 1, 2], ([3], [4, 5], [6])
"""Columns of a change of the numbers: endstops; radius of all towers; places of towers a and b on
their circle, against c, as a turn of all towers is no error; and length of all arms, tried last
among the sets of one size."""

_STEPS = 3  # of Gauss-Newton: a fourth changes nothing
_COMMON_WEIGHT = 1e-2  # of motions that are no error: small, they decide between equal numbers
_AXIS_WEIGHTS = np.array([0.3, 0.3, 1.0])
"""Weights of errors along the plate and of height: a print shows an error of a tenth of a
millimetre in height, half a layer, as clearly as one of three tenths along the plate."""

_ARM_SD = 1e-3  # metres, of arms that were entered by a rule or a shop's page
_COUNT = 7  # numbers to fit: as many touches fit exactly, so more are needed
_MIN_SPREAD = 1 / 6
"""Root mean square of the places, as a share of the towers' radius, in the direction in which they
spread least: that of a disk of a third. Touches of a plate's middle do not determine its rim."""

_MIN_RELATIVE_GAIN = 0.02  # of the tool's error now: a smaller gain is not worth a number


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


class _Fit(NamedTuple):
    """A change of the numbers ``(7,)`` with its gain, the sigma of that, and a score."""

    change: Array
    gain: float
    sigma: float
    score: float  # gain less two sigma; minus infinity if it is not certain or something is lost


def best_sizes(machine: Machine, campaigns: Iterable[Readings]) -> DeltaSizes | None:
    """Return the numbers for a calibrated delta's controller; ``None`` if touches are too few,
    or do not spread beyond the middle of the plate.

    Each subset of the sizes is fitted together with the endstops, so that the tool errs least where
    the plate was touched, which is z = 0. Its score is the gain less two standard deviations; a
    subset does not count if the error in height or along the plate rises by more than one. The
    first subset, fewest sizes first, within 2 % of the present error of the best score is returned.
    If no score exceeds 2 %, the fit of all sizes is returned and not advised.
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
    size_now, fits = _rms(now, drawn), list[_Fit]()
    for columns in [c for count in range(4) for c in combinations(_SIZES, count)]:
        change = fitted(columns)
        left = mean - slopes @ change
        after = left[: 3 * len(points)].reshape(-1, 3)
        # The decrease of the square of each error, which is linear in the deviations drawn.
        decrease = np.mean(now**2 - after**2 + 2 * drawn * (now - after), axis=1)
        height, along = decrease[:, 2], decrease[:, :2].sum(axis=1)
        rms = size_now + _rms(after, drawn)
        gain, sigma = (float(v / rms) for v in ((height + along).mean(), (height + along).std()))
        loses = any(part.mean() < -part.std() for part in (height, along))
        score = -np.inf if loses or lack_of_gain(gain, sigma) else gain - 2 * sigma
        fits.append(_Fit(change, gain, sigma, score))
    least = max(fit.score for fit in fits) - _MIN_RELATIVE_GAIN * size_now
    advised = least > 0
    chosen = next(fit for fit in fits if fit.score > least) if advised else fits[-1]
    change, (a, b) = chosen.change, chosen.change[4:6]
    # A common height or turn is no error: the middle one keeps its value.
    endstops, shifts = (v - np.median(v) for v in (change[:3], np.array([a, b, -a - b])))
    arms, wider = float(change[6]), float(change[3])
    return DeltaSizes(endstops, arms, wider, shifts, chosen.gain, chosen.sigma, advised)


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
    """Return, at points of a plate, derivatives of the tool's weighted errors by the seven numbers
    ``(3 n + 4, 7)``, these errors with the present numbers ``(3 n + 4,)``, and deviations ``(draws,
    n, 3)`` of machines drawn from the posterior, with what unmeasured rods or a bowl would do along
    the plate; metres.

    A common height, and a shift or turn along the plate, are no errors: they are projected out of
    the first 3 n rows and stand in the last four with a small weight. Deviations have no tilt
    either, as the touches determine it for every machine.
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
        mean = mean + slopes @ change  # error with the old numbers, by linearisation
        change = np.linalg.lstsq(slopes, mean)[0]
    drawn = drawn_errors(machine, commands, points + plane).reshape(-1, error.size) - error
    drawn = drawn - drawn @ rigid @ rigid.T
    # Touches measure height alone. Endstops and radius make up for what wrong arms or a bowl do to
    # heights, and an error along the plate remains that no touch shows.
    unseen = np.zeros((error.size, 2))
    unseen[:, 0] = slopes[: error.size, 6] * _ARM_SD * (machine.spec.measured.rods is None)
    unseen[2::3, 1] = PLATE_SHAPE_SD * np.sum(points**2, axis=1) / np.max(points**2)
    made_up = np.linalg.lstsq(slopes[2 : error.size : 3, :4], unseen[2::3])[0]
    unseen -= slopes[: error.size, :4] @ made_up
    unseen[2::3] = 0.0
    independent = np.random.default_rng(1)  # of the draws of `drawn_errors`
    drawn += independent.standard_normal((len(drawn), 2)) @ unseen.T
    weight = np.append(np.tile(_AXIS_WEIGHTS, len(points)), np.ones(4))
    return weight[:, None] * slopes, weight * mean, _AXIS_WEIGHTS * drawn.reshape(len(drawn), -1, 3)
