"""Rows of stored readings, and the campaigns that they make."""

from __future__ import annotations

from typing import Any

import numpy as np

from orthoglide.geometry import Array
from orthoglide.instruments import Probe
from orthoglide.layout import LinearDelta
from orthoglide.observations import ToolCampaign, ToolSetup

ROUND = 12
"""Digits of metres that are kept."""


def row(
    kind: str, setup: str, label: str, travel: Array, reading: float, second: Array | None = None
) -> dict[str, Any]:
    """One reading; ``second``: the other command of a distance."""
    return {
        "kind": kind, "setup": setup, "label": label, "travel": travel, "reading": reading,
        "second": np.full(3, np.nan) if second is None else second,
    }  # fmt: skip


def campaign_of(name: str, rows: list[dict[str, Any]], turned: float = 0.0) -> ToolCampaign:
    """Rows as a campaign, in setups by their names, of a plate turned by some degrees."""
    setups: dict[str, ToolSetup] = {}
    for one in rows:
        x, y = one.get("beside", (0.0, 0.0))
        own = ToolSetup(one["setup"], one["kind"], (float(x), float(y), 0.0), turned)
        setups.setdefault(own.name, own)
    place, n = {name: k for k, name in enumerate(setups)}, len(rows)
    plates = np.array([one["kind"] == Probe.kind for one in rows])
    return ToolCampaign(
        name=name,
        setups=tuple(setups.values()),
        setup=np.array([place[one["setup"]] for one in rows]),
        axis=np.zeros(n, dtype=np.int64),
        sign=np.ones(n),
        command=np.array([one["travel"] for one in rows]),
        second=np.array([one["second"] for one in rows]),
        approach=np.where(plates[:, None], -1.0, 0.0) * np.ones((1, 3)),  # a probe comes from above
        time=np.full(n, np.nan),
        temperature=np.full(n, np.nan),
        load=np.zeros(n),
        repeat=np.ones(n, dtype=np.int64),
        order=np.arange(1, n + 1),
        posture=tuple(one["label"] for one in rows),
        reading=np.round([one["reading"] for one in rows], ROUND),
        sigma=np.array([one.get("sigma", np.nan) for one in rows]),
        line=np.arange(2, n + 2),
        legs=LinearDelta.names,
    )
