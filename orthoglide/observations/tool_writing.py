"""Readings of the tool as rows of text; they read back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orthoglide.geometry import LEGS
from orthoglide.machine_file import MachineFile, nominal_machine_file
from orthoglide.observations.columns import (
    APPROACHED,
    BESIDE,
    MM,
    SECOND,
    TRAVELLED,
    TURNED,
    by_leg,
)
from orthoglide.observations.tool import DIRECTED, ToolCampaign
from orthoglide.observations.writing import (
    Row,
    numbers,
    rows_of,
    shown_commands,
    signs,
    with_moves,
)


def tool_rows(campaign: ToolCampaign, machine_file: MachineFile | None = None) -> list[Row]:
    """The rows of a file of tool readings, moves included; optional columns only where they say
    something.

    Args:
        campaign: the readings.
        machine_file: whose layout and controller count; the nominal one if None.
    """
    machine = machine_file or nominal_machine_file()
    legs, kinds = machine.geometry.leg_names, campaign.kind
    angles = campaign.of_kind("incline")
    directed = np.array([kind in DIRECTED for kind in kinds], dtype=bool)
    named = [
        ("-" if sign < 0 else "") + LEGS[axis] if own else ""
        for axis, sign, own in zip(campaign.axis, campaign.sign, directed, strict=True)
    ]
    needed = {
        "direction": directed.any(),
        "firmware": machine.firmware != "",
        **{name: campaign.beside[:, k].any() for k, name in enumerate(BESIDE)},
        TURNED: campaign.turned_by.any(),
        "time_s": np.isfinite(campaign.time).any(),
        "temperature_C": np.isfinite(campaign.temperature).any(),
        "load_N": campaign.load.any(),
        "reading_mm": not angles.all(),
        "reading_mrad": angles.any(),
        "sigma_mm": np.isfinite(campaign.sigma[~angles]).any(),
        "sigma_mrad": np.isfinite(campaign.sigma[angles]).any(),
        **dict.fromkeys(by_leg(SECOND, legs), campaign.of_kind("distance").any()),
    }
    columns: dict[str, Sequence[Any]] = {
        "kind": kinds,
        "setup": [campaign.setups[k].name for k in campaign.setup],
        "direction": named,
        "posture": campaign.posture,
        **shown_commands(campaign.command, machine, by_leg(TRAVELLED, legs)),
        **shown_commands(campaign.second, machine, by_leg(SECOND, legs)),
        "repeat": campaign.repeat.tolist(),
        "order": campaign.order.tolist(),
        **{n: signs(campaign.approach[:, k]) for k, n in enumerate(by_leg(APPROACHED, legs))},
        "time_s": numbers(campaign.time),
        "temperature_C": numbers(campaign.temperature),
        "load_N": numbers(campaign.load),
        "reading_mm": numbers(np.where(angles, np.nan, campaign.reading), MM),
        "reading_mrad": numbers(np.where(angles, campaign.reading, np.nan), MM),
        "sigma_mm": numbers(np.where(angles, np.nan, campaign.sigma), MM),
        "sigma_mrad": numbers(np.where(angles, campaign.sigma, np.nan), MM),
        "firmware": [machine.firmware] * len(campaign),
        **{name: numbers(campaign.beside[:, k], MM) for k, name in enumerate(BESIDE)},
        TURNED: numbers(campaign.turned_by),
    }
    rows = rows_of({name: cells for name, cells in columns.items() if needed.get(name, True)})
    moved = shown_commands(campaign.moves.command, machine, by_leg(TRAVELLED, legs))
    return with_moves(rows, campaign, moved, ("setup",))
