"""All figures of a result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orthoglide.report.figures.causes import draw_causes, draw_located, draw_signatures
from orthoglide.report.figures.readings import draw_readings, draw_residuals
from orthoglide.report.figures.style import Drawing, applied
from orthoglide.report.figures.values import draw_correlations, draw_parameters
from orthoglide.report.figures.workspace import draw_workspace

if TYPE_CHECKING:
    from orthoglide.result import Result


def draw(result: Result) -> list[Drawing]:
    """All figures of a result."""
    base, after, causes = result.before, result.after, result.effects
    before = base.predicted if result.improved else base.predicted_before
    with applied():
        drawings = [draw_causes(causes)] if causes else []
        drawings += [draw_signatures(c, after, k) for k, c in enumerate(causes, start=1)]
        drawings += [draw_located(f, k) for k, f in enumerate(result.located, start=1)]
        drawings += [draw_residuals(after, before), draw_readings(after, before)]
        if result.workspace is None:
            return [*drawings, draw_parameters(after), draw_correlations(after)]
        return [*drawings, draw_workspace(result.workspace, result.improved)]
