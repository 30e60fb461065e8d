"""Whether numbers of a machine are to be acted on, and the reading that proves a new zero."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.numerals import in_mm, signed
from orthoglide.observations import Readings, protocol
from orthoglide.ordering import largest

ShownPositions = tuple[float, float, float]

_VERDICT_REASONS = {
    "partial": "its causes explain only part of what is wrong",
    "unexplained": "something is wrong that no cause explains",
}


def withholding_reason(machine: Machine) -> str:
    """Return why the numbers of a machine should not be used, as a clause; empty if they may."""
    provenance = machine.spec.provenance
    verdict = str(provenance.get("verdict", ""))
    searched = provenance.get("command") != "identify"  # which looks for no cause
    if verdict in _VERDICT_REASONS and searched:
        return f"the verdict on this machine is {verdict}: {_VERDICT_REASONS[verdict]}"
    cautions = provenance.get("cautions", ())
    return f"the verdict on this machine warns: {cautions[0]}" if cautions else ""


def checked_for_use(source: MachineSource, force: bool) -> Machine:
    """Return the machine, if its verdict supports its numbers or ``force`` is set.

    Raises:
        InputError: saying why.
    """
    machine = Machine.of(source)
    reason = "" if force else withholding_reason(machine)
    if reason:
        raise InputError(
            f"{reason.rstrip('.')}. Its numbers are withheld: confirm the cause first, or force "
            f"them (--force, force=True)"
        )
    return machine


@dataclass(frozen=True)
class ZeroCheck:
    """One dial of the standard protocol, read at Zero and at one other posture."""

    drive: str  # whose zero is checked
    setup: str  # of the dial in the standard protocol
    touched: str  # leg that the dial touches
    direction: str  # of the dial
    gauge: float  # place of the dial along the leg, metres
    posture: str  # the other posture, `"max"` or `"min"`
    at_zero: ShownPositions  # display of the controller at Zero with the new zeros, metres
    at_posture: ShownPositions  # display of the controller at the other posture, metres
    right: float  # reading there less reading at Zero, with all zeros as they should be, metres
    wrong: float  # that difference with this drive's zero moved the wrong way
    way: str = ""  # how drives arrive at both, where lost motion makes a difference

    def as_dict(self) -> dict[str, Any]:
        """Return the check for JSON, millimetres."""
        return {
            "setup": self.setup,
            "leg": self.touched,
            "direction": self.direction,
            "gauge_mm": in_mm(self.gauge),
            "posture": self.posture,
            "shown_at_zero_mm": [*map(in_mm, self.at_zero)],
            "shown_at_posture_mm": [*map(in_mm, self.at_posture)],
            "expected_mm": in_mm(self.right),
            "expected_if_wrong_mm": in_mm(self.wrong),
            "drives_moving": self.way or None,
        }

    def __str__(self) -> str:
        arriving = f", come to both with all axes moving {self.way}" if self.way else ""
        distances = (p - z for p, z in zip(self.at_posture, self.at_zero, strict=True))
        moves = ", ".join(signed(v * 1e3, 3) for v in distances)
        right, wrong = (signed(v * 1e3, 3) for v in (self.right, self.wrong))
        return (
            f"axis {self.drive}: dial on leg {self.touched} toward {self.direction}, "
            f"{self.gauge * 1e3:.1f} mm along it; move {', '.join(LEGS)} by "
            f"{moves} mm{arriving}. Expect {right} mm; "
            f"{wrong} mm says that the zero of {self.drive} was moved the wrong way"
        )


def check_zeros(machine: Machine, offsets: Array) -> tuple[ZeroCheck, ...]:
    """Return what a dial should read once only the new zeros are entered, which take off the joint
    offsets ``(3,)``, metres: a check for each drive whose zero moves by what a dial shows.

    The dial and the postures of the standard protocol are those that show a wrong sign best.
    """
    if not machine.geometry.dialled:  # whose legs no dial is set against
        return ()
    sheet = protocol("standard", machine.geometry)
    pairs = np.concatenate([_posture_pairs(sheet, setup) for setup in range(len(sheet.setups))])
    effect_of, resolution = machine.catalogue.effect_of, machine.spec.dial.resolution
    has_backlash = any(
        abs(value) > resolution / 2 and effect_of(name).controller == "backlash"
        for name, value in machine.values.items()
    )
    right = _readings_at_shift(machine, sheet, -offsets)
    checks = []
    for drive in np.flatnonzero(offsets):
        wrong_offsets = np.where(np.arange(3) == drive, offsets, -offsets)
        wrong = _readings_at_shift(machine, sheet, wrong_offsets)
        change = right - wrong
        separation = abs(change[pairs[:, 1]] - change[pairs[:, 0]])
        best = largest(separation)
        if separation[best] < 2 * resolution:
            continue
        first, row = pairs[best].tolist()
        setup = sheet.setups[sheet.setup[row]]
        checks.append(
            ZeroCheck(
                LEGS[drive],
                setup.name,
                LEGS[setup.leg],
                setup.direction,
                setup.gauge,
                sheet.posture[row],
                _shown_positions(machine, sheet.command[first], offsets),
                _shown_positions(machine, sheet.command[row], offsets),
                float(right[row] - right[first]),
                float(wrong[row] - wrong[first]),
                machine.geometry.layout.names.slide_end_words[1][1] if has_backlash else "",
            )
        )
    return tuple(checks)


def _posture_pairs(sheet: Readings, setup: int) -> NDArray[np.int64]:
    """Return the first rows ``(n, 2)`` of a setup at Zero and at each of its other postures."""
    rows = np.flatnonzero(sheet.setup == setup)
    first_rows = {sheet.posture[row]: int(row) for row in rows[::-1]}
    zero = first_rows.pop("zero")
    return np.array([(zero, row) for row in first_rows.values()])


def _readings_at_shift(machine: Machine, sheet: Readings, shift: Array) -> Array:
    """Return the readings with every drive arriving away from the origin."""
    command = sheet.command + shift
    return machine.readings(replace(sheet, command=command, approach=np.ones_like(command)))


def _shown_positions(machine: Machine, rho: Array, offsets: Array) -> ShownPositions:
    x, y, z = machine.spec.controller.from_rho(rho - offsets, machine.geometry).tolist()
    return x, y, z
