"""What a firmware's own equations leave of its owner's readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.klipper.probe import lies
from orthoglide.klipper.stored import CALIBRATION
from orthoglide.machine_file import Firmware
from orthoglide.observations import ToolCampaign

_FITTED = 3e-5  # metres by which heights lie or lean at the rim after the firmware's own fit


@dataclass(frozen=True)
class Left:
    """Root mean squares of what is left of the readings of a file, metres."""

    file: str  # name of the campaign
    kind: str  # `heights` or `distances`
    count: int  # of the readings
    old: float  # with the old numbers
    new: float

    def as_dict(self) -> dict[str, object]:
        """For JSON, millimetres."""
        old, new = (round(v * 1e3, 6) for v in (self.old, self.new))
        return {"file": self.file, "kind": self.kind, "count": self.count,
                "old_rms_mm": old, "new_rms_mm": new}  # fmt: skip


def left_of(
    old: Firmware, new: Firmware, campaigns: Sequence[ToolCampaign], relative: bool
) -> Iterator[Left]:
    """Of each campaign's touches and distances.

    Touches count with the plate at z = 0, as the firmware meets it, and with the probe's offset set
    anew; of meshes that are ``relative`` the height does not count, and of distances no common
    scale, which a part's shrinkage is.
    """
    for one in campaigns:
        touching, paired = (np.flatnonzero(rows) for rows in (one.touching, one.paired))
        free = relative and one.name != CALIBRATION
        if len(touching):
            heights = [_heights(f, old, one.subset(touching), free) for f in (old, new)]
            yield Left(one.name, "heights", len(touching), *map(_rms, heights))
        if len(paired):
            apart = [_distances(f, old, one.subset(paired)) for f in (old, new)]
            yield Left(one.name, "distances", len(paired), *map(_rms, apart))


def _rms(off: Array) -> float:
    return float(np.sqrt(np.mean(off**2)))


def believed(firmware: Firmware, old: Firmware, command: Array) -> Array:
    """Where a firmware tells the nozzle to be ``(n, 3)`` at travel as the old one commanded it."""
    return firmware.points(command + old.zero - old.at_endstop + firmware.at_endstop)


def _offsets(
    firmware: Firmware, old: Firmware, touches: ToolCampaign
) -> Iterator[tuple[NDArray[np.bool_], float]]:
    """By setup its rows, and how much larger the probe's ``z_offset`` is as a firmware measures it
    where the old one did, metres: the probe touches with the tool in the middle, and then the
    nozzle touches that place.
    """
    for k in np.unique(touches.setup):
        own, (x, y, z) = touches.setup == k, touches.setups[k].beside
        height = float(np.median(touches.reading[own])) - z
        places = np.array([[0.0, 0.0, height], [x, y, 0.0]])
        probe, nozzle = believed(firmware, old, old.heights(places) - old.zero)[:, 2]
        yield own, float(probe - nozzle) - height


def _heights(firmware: Firmware, old: Firmware, touches: ToolCampaign, free: bool) -> Array:
    off = believed(firmware, old, touches.command)[:, 2] - touches.reading
    for own, larger in _offsets(firmware, old, touches):
        off[own] -= larger
    return off - off.mean() if free else off


def _distances(firmware: Firmware, old: Firmware, distances: ToolCampaign) -> Array:
    ends = [believed(firmware, old, c) for c in (distances.command, distances.second)]
    apart = np.linalg.norm(ends[0] - ends[1], axis=1) - distances.reading
    scale = (apart @ distances.reading) / (distances.reading @ distances.reading)
    return np.asarray(apart - scale * distances.reading)


def larger_offset(old: Firmware, new: Firmware, campaigns: Sequence[ToolCampaign]) -> float:
    """By how much the offset of a probe that touched will be larger, most of all, metres."""
    every = (one.subset(np.flatnonzero(one.touching)) for one in campaigns)
    return max((by for one in every for _, by in _offsets(new, old, one)), key=abs, default=0.0)


def fitted_already(old: Firmware, campaigns: Sequence[ToolCampaign]) -> bool:
    """Whether there is nothing but what the firmware has fitted its numbers to: its own fit leaves
    neither a mean nor a slope of its heights.
    """
    for one in campaigns:
        touches = one.subset(np.flatnonzero(one.touching))
        if one.name != CALIBRATION or not len(touches):
            return False
        p = believed(old, old, touches.command)
        mean, along_x, along_y = lies(p, touches.reading)
        leans = np.hypot(along_x, along_y) * np.hypot(*p[:, :2].T).max()
        if max(abs(mean), leans) > _FITTED:
            return False
    return True
