"""``calibrated.toml``, ``residuals.csv`` and ``next_measurements.csv``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide import __version__
from orthoglide.geometry import LEGS, Geometry
from orthoglide.machine_file import MachineFile, nominal_machine_file
from orthoglide.observations import ToolCampaign
from orthoglide.text import csv_text

if TYPE_CHECKING:
    from orthoglide.observations import Campaign
    from orthoglide.request import Request
    from orthoglide.result import Result

_FIGURES = (
    "reading_mm", "sigma_mm",
    "predicted_nominal_mm", "predicted_before_mm", "predicted_after_mm",
    "residual_nominal_mm", "residual_before_mm", "residual_after_mm",
)  # fmt: skip


def _places(geometry: Geometry) -> tuple[str, ...]:
    names = geometry.leg_names
    counted = "rho" if geometry.dialled else "travel"
    commands = tuple(f"{counted}_{leg}_mm" for leg in names)
    before = ("campaign", "line", "setup", "leg", "direction", "posture")
    return (*before, *commands, "gauge_mm", "repeat", "order")


def calibrated_machine(result: Result) -> MachineFile:
    """The machine file to go on with, with where its numbers come from."""
    request, spec = result.request, result.machine.spec
    provenance: dict[str, Any] = {
        **_origin(request),
        **spec.provenance,
        "sigma": "noise alone" if result.posterior is None else "everything else allowed",
    }
    if result.effects:
        provenance["effects"] = [e.name for e in result.effects]
    rivals = {r.name for e in result.effects for r in e.rivals}
    if rivals:
        provenance["averaged_over"] = sorted(rivals)
    nominal = spec.name == nominal_machine_file().name
    name = "Orthoglide, calibrated" if nominal else spec.name
    return replace(spec, name=name, provenance=provenance)


def _origin(request: Request) -> dict[str, Any]:
    files = [(i["file"], i["sha256"]) for i in request.inputs if "role" not in i]
    found: dict[str, Any] = {
        "version": __version__,
        "command": request.command,
        "campaigns": [{"file": name, "sha256": digest} for name, digest in files],
    }
    spec = request.machine.spec
    if spec.file:
        found["machine"] = {"file": Path(spec.file).name, "sha256": spec.sha256}
    return found


def residual_table(result: Result) -> str:
    """The text of ``residuals.csv``: nominal, before and after; faulty rows last, set aside."""
    problem, base = result.after.problem, result.before
    measured = problem.measured
    predicted = (base.predicted_before, base.predicted, result.after.predicted)
    columns = [measured, problem.sigma, *predicted, *(measured - p for p in predicted)]
    figures = np.column_stack(columns)
    rows = list[list[Any]]()
    for campaign, part in zip(problem.campaigns, problem.rows, strict=True):
        for row, values in enumerate(figures[part]):
            rows.append([*_cells(campaign, row), *map(_mm, values), ""])
    for points, part in zip(
        problem.points, problem.factor_rows[len(problem.campaigns) :], strict=True
    ):
        if isinstance(points.points, ToolCampaign):
            for row, values in enumerate(figures[part]):
                rows.append([*_tool_cells(points.points, row), *map(_mm, values), ""])
            continue
        for values, point, axis in zip(figures[part], points.point, points.setup, strict=True):
            places = [points.name, int(points.points.line[point]), "", "", LEGS[axis], ""]
            places += [*map(_mm, points.points.command[point]), "", "", int(point) + 1]
            rows.append([*places, *map(_mm, values), ""])
    for campaign, row, kind in _set_aside(result):
        empty = [""] * (len(_FIGURES) - 1)
        rows.append([*_cells(campaign, row), _mm(campaign.reading[row]), *empty, kind])
    return csv_text((*_places(problem.machine.geometry), *_FIGURES, "set_aside"), rows)


def _set_aside(result: Result) -> Iterator[tuple[Campaign, int, str]]:
    campaigns = result.first.problem.campaigns
    for blunder in result.blunders:
        if blunder.kind == "knocked_stand":  # its rows count, with a datum of their own
            continue
        for place, row in blunder.rows:
            yield campaigns[place], row, blunder.kind


def _cells(campaign: Campaign, row: int) -> list[Any]:
    setup = campaign.setups[campaign.setup[row]]
    return [
        campaign.name, campaign.line[row], setup.name, LEGS[setup.leg], setup.direction,
        campaign.posture[row], *map(_mm, campaign.command[row]), _mm(setup.gauge),
        campaign.repeat[row], campaign.order[row],
    ]  # fmt: skip


def _tool_cells(tool: ToolCampaign, row: int) -> list[Any]:
    setup = tool.setups[tool.setup[row]]
    return [
        tool.name, tool.line[row], setup.name, "", setup.kind, tool.posture[row],
        *map(_mm, tool.command[row]), "", tool.repeat[row], tool.order[row],
    ]  # fmt: skip


def _mm(metres: float) -> str:
    """Millimetres to a nanometre: further digits are rounding."""
    return f"{round(float(metres) * 1e3, 6) + 0.0:.6f}"
