"""Readings that cannot be meant as they stand are refused before any fit, all in one place.

What a table and the machine file alone show was checked when the readings were read or given
(`observations.checks`); here the machine itself says what is possible.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orthoglide.errors import InputError
from orthoglide.fit.factors import beliefs_of
from orthoglide.fit.repeats import OFF_GRID, off_grid, on_grid
from orthoglide.instruments import Beliefs, Frame, Taken
from orthoglide.machine import Machine
from orthoglide.machine_file import Dial
from orthoglide.observations import Readings, source
from orthoglide.units import INCH

_FEWEST = 8  # different readings: by chance one in eight is on the grid


def check_plausible(given: Sequence[Readings], machine: Machine, frame: Frame = "rigid") -> None:
    """Refuse readings in another unit or another frame than they are said to be.

    Args:
        given: tables, each of legs or of the tool.
        machine: near which they were taken.
        frame: how a tracker's may differ from the machine's.

    Raises:
        InputError: naming the file, the setup, what the readings seem to be and what to do.
    """
    beliefs = beliefs_of(machine, frame)
    for readings in given:
        if readings.of_tool:
            _check_meant(readings, machine, beliefs)
        else:
            _check_units(readings, machine.spec.dial)


def _check_units(campaign: Readings, dial: Dial) -> None:
    """Refuse readings of which only the inches, or only the millimetres, are what a dial shows.

    A dial shows multiples of its step. Multiplied by 25.4 they hardly ever are any more.
    """
    shown, step = np.unique(campaign.reading), dial.resolution
    if step <= 0 or len(shown) < _FEWEST or np.mean(off_grid(shown, step) < OFF_GRID) > 0.5:
        return
    for factor, meant, taken in ((1 / INCH, "millimetres", "inches"),
                                 (INCH, "inches", "millimetres")):  # fmt: skip
        if on_grid(shown * factor, step):
            raise InputError(
                f"{source(campaign)}: the readings are multiples of the dial's step of "
                f"{dial.resolution * 1e3:g} mm only once they are multiplied by {factor:.4g}: "
                f"they seem to be {meant} taken for {taken}; give reading_mm in millimetres, "
                f"or correct resolution in the machine file"
            )


def _check_meant(readings: Readings, machine: Machine, beliefs: Beliefs) -> None:
    """Refuse setups whose readings fit only in another unit or another frame.

    A machine that its owner can run stands within millimetres of the nominal one. Readings that are
    further from it, and near once a unit or a frame is exchanged, are refused before any fit: a fit
    would bend the machine for them.
    """
    p, second = machine.forward(readings.command), np.zeros_like(readings.command)
    second[readings.paired] = machine.forward(readings.second[readings.paired])
    for k, setup in enumerate(readings.setups):
        rows = readings.setup == k
        value = readings.sign[rows] * readings.reading[rows]
        taken = Taken(p[rows], np.zeros_like(p[rows]), readings.axis[rows], value, value)
        apart = np.linalg.norm(second[rows] - p[rows], axis=1)
        if said := setup.observation.doubts(taken, apart, beliefs):
            where = "" if readings.by_point else f", setup {setup.name!r}"
            raise InputError(f"{source(readings)}{where}: {said}")
