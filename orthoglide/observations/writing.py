"""Campaigns and measuring sheets as CSV files; what is written reads back exactly."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from orthoglide import files, units
from orthoglide.geometry import LEGS, Geometry
from orthoglide.observations.campaign import Campaign, derive_approach
from orthoglide.observations.protocols import Kind, protocol

MM = 1e-3


def write_campaign(
    campaign: Campaign, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Writes a campaign; optional columns only where they say something.

    Args:
        campaign: what to write; readings that are nan are left empty.
        path: where to.
        overwrite: whether an existing file may be replaced.

    Raises:
        FileError: where a file stands already and may not be replaced, or none can be written.
    """
    files.write_whole(path, campaign_text(campaign), overwrite=overwrite)


def write_protocol(
    kind: Kind,
    path: str | os.PathLike[str],
    geometry: Geometry | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Writes a measuring sheet: every column filled in but the readings.

    Args:
        kind: as for `protocol`.
        path: where to.
        geometry: whose stroke and length count; the nominal one if None.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: for an unknown kind.
        FileError: as `write_campaign`.
    """
    write_campaign(protocol(kind, geometry), path, overwrite=overwrite)


def campaign_text(campaign: Campaign) -> str:
    """The CSV text of a campaign."""
    columns = {name: cells(campaign) for name, cells in _columns(campaign).items()}
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return stream.getvalue()


Cells = Callable[[Campaign], Sequence[Any]]


def _columns(campaign: Campaign) -> dict[str, Cells]:
    """The columns that this campaign needs, in the order of FORMAT's table."""
    derived = derive_approach(campaign.command, campaign.order)
    needed = {
        "bar": any(s.bar for s in campaign.setups),
        **dict.fromkeys(_APPROACH, not np.array_equal(campaign.approach, derived)),
        "time_s": bool(np.isfinite(campaign.time).any()),
        "temperature_C": bool(np.isfinite(campaign.temperature).any()),
        "load_N": bool(campaign.load.any()),
        "sigma_mm": bool(np.isfinite(campaign.sigma).any()),
    }
    return {name: cells for name, cells in _WRITERS.items() if needed.get(name, True)}


def _number(value: float, factor: float = 1.0) -> str:
    return "" if np.isnan(value) else str(units.from_si(value, factor))


def _numbers(field: str, factor: float = 1.0) -> Cells:
    return lambda campaign: [_number(v, factor) for v in getattr(campaign, field).tolist()]


def _of_setup(cell: Callable[[Any], Any]) -> Cells:
    return lambda campaign: [cell(campaign.setups[place]) for place in campaign.setup]


def _command(axis: int) -> Cells:
    return lambda campaign: [_number(v, MM) for v in campaign.command[:, axis].tolist()]


def _approach(axis: int) -> Cells:
    signs = {1: "1", -1: "-1", 0: ""}
    return lambda campaign: [signs[int(v)] for v in campaign.approach[:, axis]]


_APPROACH = tuple(f"approach_{leg}" for leg in LEGS)
_WRITERS: dict[str, Cells] = {
    "setup": _of_setup(lambda s: s.name),
    "leg": _of_setup(lambda s: LEGS[s.leg]),
    "direction": _of_setup(lambda s: s.direction),
    "posture": lambda campaign: campaign.posture,
    **{f"rho_{leg}_mm": _command(axis) for axis, leg in enumerate(LEGS)},
    "gauge_mm": _of_setup(lambda s: _number(s.gauge, MM)),
    "bar": _of_setup(lambda s: s.bar or ""),
    "repeat": lambda campaign: campaign.repeat.tolist(),
    "order": lambda campaign: campaign.order.tolist(),
    **{name: _approach(axis) for axis, name in enumerate(_APPROACH)},
    "time_s": _numbers("time"),
    "temperature_C": _numbers("temperature"),
    "load_N": _numbers("load"),
    "reading_mm": _numbers("reading", MM),
    "sigma_mm": _numbers("sigma", MM),
}
