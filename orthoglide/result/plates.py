"""Plates as they were touched, and where the firmware's z = 0 is among them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.fit import Estimate
from orthoglide.geometry import Array, plane_columns
from orthoglide.klipper import CALIBRATION, RELATIVE
from orthoglide.machine import Machine
from orthoglide.machine_file import Firmware
from orthoglide.mechanism.six_bars import ROTATION, TCP
from orthoglide.prediction import Conditions

_WIDE = 0.8
"""Of the widest plate, how far another one of more touches has to reach in its place."""


@dataclass(frozen=True, eq=False)
class Plate:
    """A plate as it was touched in one mounting."""

    file: str  # name of its campaign
    radius: float  # that was touched
    commands: Array  # of the touches (n, 3)
    places: Array  # where they were (n, 2)
    reading: Array  # height of the nozzle over the plate there, as told (n,)
    sigma: float  # of one
    beside: Array  # where the probe is, from the nozzle (3,)
    relative: bool  # whether the height at one place is taken out

    @property
    def taken(self) -> Array:
        """Takes height and slopes out of heights at its touches ``(3, n)``."""
        return np.asarray(np.linalg.pinv(plane_columns(self.places)))

    @property
    def height(self) -> float:
        """Of the nozzle as the firmware told it where the probe touched."""
        return float(np.median(self.reading)) - float(self.beside[2])


def plates(fit: Estimate) -> list[Plate]:
    """All that were touched three times at least."""
    found, problem = list[Plate](), fit.problem
    kept = problem.machine.spec.provenance.get("klipper")
    relative = isinstance(kept, Mapping) and bool(kept.get(RELATIVE))
    for k, factor, number, setup in problem.mounted:
        own = np.flatnonzero(factor.setup == number)
        if not setup.instrument.touches or len(own) < 3:
            continue
        rows, places = problem.factor_rows[k], fit.at.slopes[k][own, :2]
        file = factor.points.name
        found.append(Plate(
            file, float(np.hypot(*places.T).max()), factor.points.command[own], places,
            problem.measured[rows][own], float(np.median(problem.sigma[rows][own])),
            np.array(setup.beside), relative and file != CALIBRATION,
        ))  # fmt: skip
    return found


def far_out(found: Sequence[Plate]) -> list[Plate]:
    """Those that were touched about as far out as any."""
    most = max((one.radius for one in found), default=0.0)
    return [one for one in found if one.radius >= _WIDE * most]


def widest(found: Sequence[Plate]) -> Plate | None:
    """The one that was touched out to its rim by most touches; ``None`` where none was."""
    return max(
        far_out(found), key=lambda one: (len(one.places), one.radius, one.file), default=None
    )


def for_zero(found: Sequence[Plate]) -> list[Plate]:
    """Those that say where z = 0 is, and how it lies: the heights by which the firmware set it;
    else all that were touched far out.
    """
    return [one for one in found if one.file == CALIBRATION] or far_out(found)


def mean_of(each: Iterable[tuple[Plate, Array]]) -> Array:
    """Of what ``(3, ...)`` several plates say, height and slopes: all count alike, as they lie
    apart by more than their touches are noisy; the height is that of those who know it.
    """
    told = list(each)
    know = [own for one, own in told if not one.relative] or [own for _, own in told]
    slopes = [own[1:] for _, own in told]
    return np.concatenate([[np.mean([own[0] for own in know], axis=0)], np.mean(slopes, axis=0)])


def plane_of(plate: Plate, old: Firmware, machine: Machine) -> Array:
    """Height and slopes ``(3,)``, metres, of the surface on which the nozzle stands at z = 0.

    That is what the probe touched, less how much higher it is than the nozzle. This was measured
    by the firmware itself: the probe touched with the tool in the middle, and then the nozzle
    touched the same place, lower by ``z_offset`` as the firmware tells it.
    """
    heights = _tips(machine, plate.commands, plate.beside) - plate.reading
    probe, nozzle = _offset_was_set(old, machine, plate)
    above = _tips(machine, probe, plate.beside) - float(np.median(plate.reading))
    own = plate.taken @ heights
    own[0] += float((machine.forward(nozzle)[:, 2] - above)[0])
    return np.asarray(own)


def plane_slopes(plate: Plate, old: Firmware, machine: Machine) -> Array:
    """The same by the parameters of the machine's posterior ``(3, P)``."""
    probe, nozzle = _offset_was_set(old, machine, plate)
    own = plate.taken @ tip_slopes(machine, plate.commands, plate.beside)
    own[0] += tip_slopes(machine, nozzle)[0] - tip_slopes(machine, probe, plate.beside)[0]
    return np.asarray(own)


def _offset_was_set(old: Firmware, machine: Machine, plate: Plate) -> tuple[Array, Array]:
    """Commands with which the probe and the nozzle touched one place ``(1, 3)`` each."""
    at_zero = np.array([leg.carriage[2] - leg.platform[2] for leg in machine.geometry.legs])
    x, y, _ = plate.beside
    probe, nozzle = old.heights(np.array([[0.0, 0.0, plate.height], [x, y, 0.0]])) - at_zero
    return probe[None], nozzle[None]


def _tips(machine: Machine, commands: Array, beside: Array) -> Array:
    """Heights of the probe ``(n,)`` at commands ``(n, 3)``."""
    pose = machine.pose(commands)
    return np.asarray(pose.p[:, 2] + pose.R[:, 2] @ beside)


def tip_slopes(machine: Machine, commands: Array, beside: Array | None = None) -> Array:
    """The same, of the nozzle if nothing is said, by the posterior's parameters ``(n, P)``."""
    names = machine.posterior.names
    _, slopes = machine.model.sensitivities(machine.values, Conditions.at(commands), names)
    lifted = slopes[:, ROTATION][:, 6:]  # of the last row
    height = slopes[:, TCP][:, 2]
    return height if beside is None else height + np.einsum("nkp,k->np", lifted, beside)
