"""What a verdict of the Python interface was asked, so that its report can be run again too."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orthoglide.files import sha256
from orthoglide.report.run import InputFile, Role, Run

if TYPE_CHECKING:
    from orthoglide.closing import Verdict
    from orthoglide.observations import Campaign, TcpPoints


def run_of(verdict: Verdict) -> Run:
    """The run behind a verdict: its campaigns as they came, faulty rows included."""
    first = verdict.faulty or verdict.base
    campaigns = first.problem.campaigns
    held, points = verdict.judges
    inputs = [_campaign_input(c, "campaign") for c in campaigns]
    if held is not None:
        inputs.append(_campaign_input(held, "holdout"))
    if points is not None:
        inputs.append(_tcp_input(points))
    machine = Path(first.problem.machine.spec.file).name
    noise = _declared(verdict)
    return Run(
        "close-loop",
        arguments(
            [i.file for i in inputs if i.role == "campaign"],
            own=verdict.own,
            machine=machine or None,
            noise_mm=None if noise is None else round(noise * 1e3, 12),
            holdout=next((i.file for i in inputs if i.role == "holdout"), None),
            tcp=next((i.file for i in inputs if i.role == "tcp"), None),
        ),
        tuple(inputs),
        verdict.seed,
        again="orthoglide rerun result.json --out DIR",
    )


def arguments(
    campaigns: list[str],
    *,
    own: tuple[str, ...],
    machine: str | None,
    noise_mm: float | None,
    holdout: str | None,
    tcp: str | None,
) -> dict[str, Any]:
    """As `result.json` keeps them: names of files, no places."""
    return {
        "campaigns": campaigns,
        "own": list(own),
        "machine": machine,
        "noise_mm": noise_mm,
        "holdout": holdout,
        "tcp": tcp,
    }


def _declared(verdict: Verdict) -> float | None:
    """The noise where the caller declared it, metres; ``None`` where rows or repeats say it."""
    noise = (verdict.faulty or verdict.base).problem.noise
    campaigns = (verdict.faulty or verdict.base).problem.campaigns
    by_rows = all(np.isfinite(c.sigma).all() for c in campaigns)
    if noise.source != "declared" or by_rows:
        return None
    return noise.typical


def _campaign_input(campaign: Campaign, role: Role) -> InputFile:
    from orthoglide.observations import campaign_rows, csv_text

    rows = tuple(campaign_rows(campaign))
    lines = tuple(sorted([*campaign.line.tolist(), *campaign.moves.line.tolist()]))
    follow = lines == tuple(range(2, len(rows) + 2))
    digest = campaign.sha256 or sha256(csv_text(rows).encode())
    return InputFile(f"{campaign.name}.csv", digest, rows, role, () if follow else lines)


def _tcp_input(points: TcpPoints) -> InputFile:
    from orthoglide.observations import tcp_rows

    rows = tuple(tcp_rows(points))
    name = Path(points.file).name or "points.tcp.csv"
    return InputFile(name, points.sha256 or sha256(repr(rows).encode()), rows, "tcp")
