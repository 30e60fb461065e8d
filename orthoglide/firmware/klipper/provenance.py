"""Keys of a printer's table in a machine file, and readings that contradict its numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from orthoglide.firmware.klipper.numbers import Numbers
from orthoglide.geometry import Array, plane_columns
from orthoglide.notes import Note
from orthoglide.observations import Readings

FIRMWARE_NAME = "klipper"
"""Name of the table of a machine file, and of the entry point."""

CALIBRATION = "calibration"
"""Name of the readings of [delta_calibrate]: heights and distances. They are stored as steps from
the endstops and, unlike meshes, are valid for any numbers of the firmware."""

WARNINGS_KEY, CALIBRATE_AGAIN_KEY = "warnings", "calibrate_again"
"""Keys of the table: sentences of the import, and whether the firmware's own calibration has to be
run again before any number is entered."""

MESHES_RELATIVE_KEY, ASSUMED_KEY, CORRECTED_KEY = "meshes_relative", "assumed_mm", "corrected"
"""Keys of the table: whether the height at one place is subtracted from meshes, what the firmware
does not store, and new numbers of a calibrated machine."""

MAX_ROD_SPREAD = 5e-4  # metres: largest difference of rods of one set
_EQUAL_ARMS = 5e-5  # metres: largest difference of arms that are taken as equal
_MAX_HEIGHT_DIFFERENCE = 2e-4
"""Metres by which the heights of two lists may differ at three quarters of the places that both
touched. Of 14 pairs on owners' printers, probed warm and cold, none differs by more than 0.13 mm at
nine tenths. A quarter may differ by more, because one wrong touch of seven is told only if it stays
beside a list that contradicts it."""
_MIN_COMMON_PLACES = 4  # places that establish a difference


def disagreements(
    numbers: Numbers, campaigns: Sequence[Readings], *, meshes_relative: bool = False
) -> Iterator[tuple[str, str, Note]]:
    """Yield the names of two lists of touches whose heights differ at common places, and a note.

    Between them the plate or an endstop was moved, or the firmware's numbers were changed. From
    meshes that are relative the firmware subtracts the height at one place.
    """
    agreed = list[Readings]()
    for campaign in sorted(campaigns, key=lambda c: c.name != CALIBRATION):
        for other in agreed:
            difference = _height_difference(numbers, campaign, other, meshes_relative)
            if difference > _MAX_HEIGHT_DIFFERENCE:
                yield campaign.name, other.name, Note(
                    f"{campaign.name}.csv and {other.name}.csv are not of one plate and one set of "
                    f"numbers: at a quarter of the places that both touched, their heights differ "
                    f"by {difference * 1e3:.2f} mm or more. Leave the older of the two out, or "
                    f"probe it again; of a plate that was turned say by how much (--turned "
                    f"NAME=DEGREES)",
                    "apart",
                )  # fmt: skip
                break
        else:
            agreed.append(campaign)


def _height_difference(
    numbers: Numbers, campaign: Readings, other: Readings, meshes_relative: bool
) -> float:
    """Return the 0.75 quantile of the differences of two lists' heights at common places, metres; 0
    if these are too few, or the plate was turned between them.
    """
    from scipy.interpolate import LinearNDInterpolator  # which is slow to load

    few, many = sorted((campaign, other), key=lambda c: int(c.touching.sum()))
    (p, low), (q, high) = (_touched_heights(numbers, c) for c in (few, many))
    turns = [c.turned_by[c.touching].max(initial=0.0) for c in (campaign, other)]
    if turns[0] != turns[1] or np.linalg.matrix_rank(plane_columns(q), tol=1e-3) < 3:
        return 0.0
    q, first = np.unique(np.round(q, 5), axis=0, return_index=True)
    difference = low - LinearNDInterpolator(q, high[first])(p)
    difference = difference[np.isfinite(difference)]
    if len(difference) < _MIN_COMMON_PLACES:
        return 0.0
    if meshes_relative:
        difference = difference - np.median(difference)
    return float(np.quantile(np.abs(difference), 0.75))


def _touched_heights(numbers: Numbers, campaign: Readings) -> tuple[Array, Array]:
    """Return places ``(n, 2)`` of touches and heights of the plate there ``(n,)``, metres."""
    rows = campaign.touching
    p = numbers.points(campaign.command[rows] + numbers.zero)
    return p[:, :2], p[:, 2] - campaign.reading[rows]


def unequal_arms_warning(numbers: Numbers) -> str:
    """Return a warning on stored arms that differ; empty if they are equal."""
    if (spread := float(np.ptp(numbers.arm))) <= _EQUAL_ARMS:
        return ""
    arms = ", ".join(f"{v * 1e3:.3f}" for v in numbers.arm)
    doubt = ", more than rods of one set do. Measure the rods before you trust any of its numbers"
    return (
        f"The arms that the firmware stores ({arms} mm) differ by {spread * 1e3:.2f} mm"
        f"{doubt * (spread > MAX_ROD_SPREAD)}. They are taken as alike to {_EQUAL_ARMS * 1e3:g} "
        f"mm: if you did measure them, give the sigma of your measurement under [parameters] of "
        f"the machine file."
    )
