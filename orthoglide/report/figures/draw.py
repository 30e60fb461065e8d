"""All figures of a result."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from orthoglide.errors import InputError
from orthoglide.report.figures.causes import draw_causes, draw_located, draw_signatures
from orthoglide.report.figures.readings import draw_readings, draw_residuals
from orthoglide.report.figures.style import Drawing, applied
from orthoglide.report.figures.values import draw_correlations, draw_parameters
from orthoglide.report.figures.workspace import draw_vectors, draw_workspace

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


def draw_one(result: Result, what: str) -> Drawing:
    """One figure by what it shows.

    Args:
        result: what was found.
        what: ``"residuals"``, ``"readings"``, ``"causes"``, ``"tool"`` or ``"parameters"``.

    Raises:
        InputError: for a figure that there is not, or not of this result.
    """
    base, after = result.before, result.after
    before = base.predicted if result.improved else base.predicted_before
    ways: dict[str, Callable[[], Drawing]] = {
        "residuals": lambda: draw_residuals(after, before),
        "readings": lambda: draw_readings(after, before),
        "parameters": lambda: draw_parameters(after),
    }
    if result.effects:
        ways["causes"] = lambda: draw_causes(result.effects)
    if (space := result.workspace) is not None:
        ways["tool"] = lambda: draw_vectors(space)
    if what not in ways:
        raise InputError(f"this result has no figure {what!r}: it has {', '.join(ways)}")
    with applied():
        return ways[what]()
