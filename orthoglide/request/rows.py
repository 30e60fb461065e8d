"""Campaigns and points to rows of text and back."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from orthoglide.machine_file import MachineFile, nominal_machine_file
from orthoglide.observations import Campaign, TcpPoints, campaign_text, reading
from orthoglide.observations.table import Table


def campaign_rows(campaign: Campaign) -> list[dict[str, str]]:
    """Rows of a campaign."""
    return list(csv.DictReader(io.StringIO(campaign_text(campaign))))


def tcp_rows(points: TcpPoints) -> list[dict[str, str]]:
    """Rows of TCP points."""
    sigma = points.sigma[:, None] * 1e3
    table = np.hstack([points.command * 1e3, points.p * 1e3, points.approach, sigma])
    names = (*reading.RHO, *reading.POINT, *reading.APPROACH, "sigma_mm")
    return [
        {n: "" if np.isnan(v) else f"{v:.12g}" for n, v in zip(names, row, strict=True)}
        for row in table.tolist()
    ]


def _table(
    rows: Sequence[Mapping[str, str]], file: str, lines: Sequence[int], sha256: str
) -> Table:
    names = tuple(rows[0])
    cells = tuple([row.get(name, "") for name in names] for row in rows)
    return Table(names, cells, tuple(lines) or tuple(range(2, len(rows) + 2)), file, sha256)


def campaign_from_rows(
    rows: Sequence[Mapping[str, str]],
    machine_file: MachineFile,
    *,
    name: str,
    lines: Sequence[int] = (),
    file: str = "",
    sha256: str = "",
) -> Campaign:
    """A campaign from its rows."""
    build: Any = reading._campaign
    campaign: Campaign = build(_table(rows, file, lines, sha256), name, machine_file, True)
    return replace(campaign, file=file, sha256=sha256)


def tcp_from_rows(
    rows: Sequence[Mapping[str, str]],
    machine_file: MachineFile,
    *,
    file: str,
    lines: Sequence[int] = (),
    sha256: str = "",
) -> TcpPoints:
    """TCP points from their rows."""
    table, read = _table(rows, file, lines, sha256), cast(Any, reading)
    machine = machine_file or nominal_machine_file()
    return TcpPoints(
        command=read._commands(table, read._command_names(table), machine),
        p=read._columns(table, reading.POINT, read._COORDINATE),
        sigma=np.array(table.values("sigma_mm", reading.ROW_COLUMNS["sigma_mm"])),
        approach=read._columns(table, reading.APPROACH, read._APPROACH),
        line=np.array(table.lines),
        file=file,
        sha256=sha256,
    )
