"""A printer under the firmware, as the table of its machine file has it."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.firmware.klipper.numbers import TOWERS, Numbers
from orthoglide.geometry import Array, Geometry, plane_columns
from orthoglide.layout import LinearDelta
from orthoglide.machine_file import DeltaKinematics
from orthoglide.notes import Note
from orthoglide.observations import Readings

NAME = "klipper"
"""Name of the table of a machine file, and of the entry point."""

CALIBRATION = "calibration"
"""Name of the readings of [delta_calibrate]: heights and distances, which are stored as steps from
the endstops and go with any numbers of the firmware, as meshes do not."""

WARNINGS, AGAIN = "warnings", "calibrate_again"
"""Keys of the table: sentences of the import, and whether the firmware's own calibration is to be
run again before anything is entered."""

RELATIVE, ASSUMED, CORRECTED = "meshes_relative", "assumed_mm", "corrected"
"""Keys of the table: whether the height at one place is taken out of meshes, what the firmware does
not store, and new numbers of a calibrated machine."""

SPREAD = 5e-4  # metres by which rods of one set do not differ
_EVEN = 5e-5  # metres within which arms are taken as alike
_NEAR = 1.5e-4  # metres from the stored arms: less than half of the spread
_SAME = 2e-6  # metres by which lengths of the file may be rounded
_APART = 2e-4
"""Metres by which a tenth of the heights of two lists may differ where both touched: of 14 pairs on
owners' printers, probed warm and cold, none differs by more than 0.13 mm."""
_COMMON = 4  # places that tell of a difference
_NAMED_APART = re.compile(r"(\S+)\.csv and (\S+)\.csv are not of one plate")
_ASSUMED = {
    "r": "the platform's radius",
    "d": "the distance of an arm's two rods",
    "tool_below": "how far the nozzle hangs below the joints",
}


def disagreements(
    numbers: Numbers, campaigns: Sequence[Readings], *, relative: bool = False
) -> Iterator[tuple[str, str, Note]]:
    """Yield the name of every list of touches whose heights differ from those of another one where
    both touched, that one's name, and a note: between them the plate or an endstop was moved, or
    the firmware's numbers were changed.

    Args:
        numbers: the firmware's present ones.
        campaigns: that were imported.
        relative: whether the firmware takes the height at one place out of every mesh.
    """
    agreed = list[Readings]()
    for campaign in sorted(campaigns, key=lambda c: c.name != CALIBRATION):
        for other in agreed:
            most = _difference(numbers, campaign, other, relative)
            if most > _APART:
                words = (
                    f"{campaign.name}.csv and {other.name}.csv are not of one plate and one set of "
                    f"numbers: where both touched, their heights differ by {most * 1e3:.2f} mm. "
                    f"Leave the older of the two out, or probe it again; of a plate that was "
                    f"turned say by how much (--turned NAME=DEGREES)"
                )
                yield campaign.name, other.name, Note(words, "apart")
                break
        else:
            agreed.append(campaign)


def _difference(numbers: Numbers, one: Readings, other: Readings, relative: bool) -> float:
    """Return by how much the heights of a tenth of the common places of two lists differ at least,
    metres; 0 where there are too few, or the plate was turned between them.
    """
    from scipy.interpolate import LinearNDInterpolator  # which is slow to load

    few, many = sorted((one, other), key=lambda c: int(c.touching.sum()))
    (p, low), (q, high) = (_surface(numbers, c) for c in (few, many))
    turns = [c.turned_by[c.touching].max(initial=0.0) for c in (one, other)]
    if turns[0] != turns[1] or np.linalg.matrix_rank(plane_columns(q), tol=1e-3) < 3:
        return 0.0
    q, first = np.unique(np.round(q, 5), axis=0, return_index=True)
    off = low - LinearNDInterpolator(q, high[first])(p)
    off = off[np.isfinite(off)]
    if len(off) < _COMMON:
        return 0.0
    if relative:
        off = off - np.median(off)
    return float(np.quantile(np.abs(off), 0.9))


def _surface(numbers: Numbers, campaign: Readings) -> tuple[Array, Array]:
    """Return places ``(n, 2)`` and height of the plate ``(n,)`` of touches, metres."""
    rows = campaign.touching
    p = numbers.points(campaign.command[rows] + numbers.zero)
    return p[:, :2], p[:, 2] - campaign.reading[rows]


def rods_words(numbers: Numbers) -> str:
    """Say what is to be known of arms that differ; empty where they do not."""
    if (spread := float(np.ptp(numbers.arm))) <= _EVEN:
        return ""
    arms = ", ".join(f"{v * 1e3:.3f}" for v in numbers.arm)
    doubt = ", more than rods of one set do. Measure the rods before you trust any of its numbers"
    return (
        f"The arms that the firmware stores ({arms} mm) differ by {spread * 1e3:.2f} mm"
        f"{doubt * (spread > SPREAD)}. They are taken as alike to {_EVEN * 1e3:g} mm: if you did "
        f"measure them, give the sigma of your measurement under [parameters] of machine.toml."
    )


@dataclass(frozen=True)
class Printer:
    """The firmware's numbers of one machine, with what the import keeps beside them."""

    numbers: Numbers
    table: Mapping[str, Any]

    @property
    def relative(self) -> bool:
        """Whether the firmware takes the height at one place out of every mesh."""
        return bool(self.table.get(RELATIVE))

    @property
    def kinematics(self) -> DeltaKinematics:
        """Where the firmware sends the carriages, from mechanical zero of the machine file."""
        return self.numbers.kinematics(self.numbers.zero)

    def objection(self, geometry: Geometry) -> tuple[str, ...]:
        """Return why dimensions would move mechanical zero away from where travel is counted from,
        and the path of the key to blame; empty where they would not.

        The joints of the platform may stand further out than was assumed, but only together with
        those of the carriages.
        """
        layout, reach, arm = geometry.layout, self.numbers.delta_radius, self.numbers.mean_arm
        if not isinstance(layout, LinearDelta):
            return ()
        if any(abs(radius - geometry.r - reach) > _SAME for radius in layout.radius):
            return (
                f"radius_mm less r must stay the firmware's delta_radius, {reach * 1e3:.6g} mm, by "
                f"which travel was counted: with r = {geometry.r * 1e3:.6g} put "
                f"{(reach + geometry.r) * 1e3:.9g} three times",
                "layout",
                "radius_mm",
            )
        if abs(geometry.L - arm) > _SAME:
            return (
                f"L must stay the mean of the firmware's arms, {arm * 1e3:.6f} mm, by which travel "
                f"was counted: give lengths that were measured under [parameters]",
                "geometry_mm",
                "L",
            )
        return ()

    def doubts(self, machine: Any) -> str:
        """Say that the stored arms cannot be those of one set of rods, unless the machine's file
        says that they were measured: by a sigma beside lengths near the stored ones.
        """
        if np.ptp(self.numbers.arm) <= SPREAD or machine.spec.measured.rods:
            return ""
        length = next(e.name for e in machine.catalogue.effects if e.controller == "bar_length")
        given = [machine.spec.parameters.get(f"{length}.{tower}") for tower in TOWERS]
        measured = all(
            own is not None and own.sigma > 0
            and abs(own.value - (arm - machine.geometry.L)) <= _NEAR
            for own, arm in zip(given, self.numbers.arm, strict=True)
        )  # fmt: skip
        return "" if measured else rods_words(self.numbers)

    def imported(self, names: Collection[str]) -> Iterator[Note]:
        """Return the remarks of the import for a result of readings of these names.

        That two do not go together is found anew where both are read, and matters only to the
        first.
        """
        kept = self.table.get(WARNINGS)
        for text in kept if isinstance(kept, list) else ():
            if isinstance(text, str) and (
                (two := _NAMED_APART.match(text)) is None
                or (two[1] in names and two[2] not in names)
            ):
                yield Note(text, "imported")

    def cautions(self, readings: Sequence[Any]) -> Iterator[Note]:
        """Return which readings are not of one plate and one set of the numbers."""
        touched = [one for one in readings if isinstance(one, Readings)]
        found = disagreements(self.numbers, touched, relative=self.relative)
        yield from (note for _, _, note in found)

    def assumptions(self, machine: Any, causes: Sequence[Any]) -> Iterator[Note]:
        """Say what was assumed on import and is so still, where causes depend on it."""
        every = [one for cause in causes for one in cause.explanations]
        assumed, geometry = self.table.get(ASSUMED), machine.geometry
        of_machine = any(not one.catalogue.effect_of(one.name).of_dial for one in every)
        if not (of_machine and isinstance(assumed, Mapping)):
            return
        below = float(geometry.legs[0].platform[2])
        now = {"r": geometry.r, "d": geometry.d, "tool_below": below}
        same = {n: v for n, v in assumed.items() if abs(now.get(n, np.inf) * 1e3 - v) < 1e-6}
        if same:
            sizes = ", ".join(f"{_ASSUMED[n]} ({v:g} mm)" for n, v in same.items())
            yield Note(
                f"assumed, as no firmware stores it: {sizes}; sizes of causes that turn the "
                f"platform go with that, and their uncertainty does not count it: measure it and "
                f"correct it in machine.toml",
                "assumed",
            )

    def provenance(self, corrections: Any) -> Mapping[str, Any]:
        """Return the table, by its name, that a calibrated machine keeps."""
        table = {key: value for key, value in self.table.items() if key != CORRECTED}
        new = {} if corrections is None else {CORRECTED: corrections.kept}
        return {NAME: table | new}


def printer_of(table: Mapping[str, Any]) -> Printer | None:
    """Return the printer of a table; ``None`` where the table was edited and has no numbers."""
    try:
        return Printer(Numbers.of(table), table)
    except (KeyError, TypeError, ValueError):
        return None
