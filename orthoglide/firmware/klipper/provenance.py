"""What the table of a machine file keeps of a printer, and which readings speak against it."""

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
"""Name of the readings of [delta_calibrate]: heights and distances, which are stored as steps from
the endstops and go with any numbers of the firmware, as meshes do not."""

WARNINGS_KEY, CALIBRATE_AGAIN_KEY = "warnings", "calibrate_again"
"""Keys of the table: sentences of the import, and whether the firmware's own calibration is to be
run again before anything is entered."""

MESHES_RELATIVE_KEY, ASSUMED_KEY, CORRECTED_KEY = "meshes_relative", "assumed_mm", "corrected"
"""Keys of the table: whether the height at one place is taken out of meshes, what the firmware does
not store, and new numbers of a calibrated machine."""

MAX_ROD_SPREAD = 5e-4  # metres by which rods of one set do not differ
_EQUAL_ARMS = 5e-5  # metres within which arms are taken as alike
_MAX_HEIGHT_DIFFERENCE = 2e-4
"""Metres by which a tenth of the heights of two lists may differ where both touched: of 14 pairs on
owners' printers, probed warm and cold, none differs by more than 0.13 mm."""
_MIN_COMMON_PLACES = 4  # places that tell of a difference


def disagreements(
    numbers: Numbers, campaigns: Sequence[Readings], *, meshes_relative: bool = False
) -> Iterator[tuple[str, str, Note]]:
    """Yield the name of every list of touches whose heights differ from those of another one where
    both touched, that one's name, and a note: between them the plate or an endstop was moved, or
    the firmware's numbers were changed.

    Args:
        numbers: the firmware's present ones.
        campaigns: that were imported.
        meshes_relative: whether the firmware takes the height at one place out of every mesh.
    """
    agreed = list[Readings]()
    for campaign in sorted(campaigns, key=lambda c: c.name != CALIBRATION):
        for other in agreed:
            most = _height_difference(numbers, campaign, other, meshes_relative)
            if most > _MAX_HEIGHT_DIFFERENCE:
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


def _height_difference(numbers: Numbers, one: Readings, other: Readings, relative: bool) -> float:
    """Return by how much the heights of a tenth of the common places of two lists differ at least,
    metres; 0 where there are too few, or the plate was turned between them.
    """
    from scipy.interpolate import LinearNDInterpolator  # which is slow to load

    few, many = sorted((one, other), key=lambda c: int(c.touching.sum()))
    (p, low), (q, high) = (_touched_heights(numbers, c) for c in (few, many))
    turns = [c.turned_by[c.touching].max(initial=0.0) for c in (one, other)]
    if turns[0] != turns[1] or np.linalg.matrix_rank(plane_columns(q), tol=1e-3) < 3:
        return 0.0
    q, first = np.unique(np.round(q, 5), axis=0, return_index=True)
    off = low - LinearNDInterpolator(q, high[first])(p)
    off = off[np.isfinite(off)]
    if len(off) < _MIN_COMMON_PLACES:
        return 0.0
    if relative:
        off = off - np.median(off)
    return float(np.quantile(np.abs(off), 0.9))


def _touched_heights(numbers: Numbers, campaign: Readings) -> tuple[Array, Array]:
    """Return places ``(n, 2)`` and height of the plate ``(n,)`` of touches, metres."""
    rows = campaign.touching
    p = numbers.points(campaign.command[rows] + numbers.zero)
    return p[:, :2], p[:, 2] - campaign.reading[rows]


def unequal_arms_warning(numbers: Numbers) -> str:
    """Say what is to be known of arms that differ; empty where they do not."""
    if (spread := float(np.ptp(numbers.arm))) <= _EQUAL_ARMS:
        return ""
    arms = ", ".join(f"{v * 1e3:.3f}" for v in numbers.arm)
    doubt = ", more than rods of one set do. Measure the rods before you trust any of its numbers"
    return (
        f"The arms that the firmware stores ({arms} mm) differ by {spread * 1e3:.2f} mm"
        f"{doubt * (spread > MAX_ROD_SPREAD)}. They are taken as alike to {_EQUAL_ARMS * 1e3:g} mm: if you did "
        f"measure them, give the sigma of your measurement under [parameters] of the machine file."
    )
