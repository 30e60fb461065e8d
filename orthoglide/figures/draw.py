"""All figures of a result."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from orthoglide.errors import InputError
from orthoglide.figures.causes import draw_causes, draw_located, draw_signatures
from orthoglide.figures.readings import draw_readings, draw_residuals
from orthoglide.figures.style import Drawing, applied
from orthoglide.figures.values import draw_correlations, draw_parameters
from orthoglide.figures.workspace import draw_vectors, draw_workspace

if TYPE_CHECKING:
    from orthoglide.fit import Estimate
    from orthoglide.geometry import Array
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


Ways = dict[str, Callable[[], Drawing]]


def draw_one(result: Result, what: str) -> Drawing:
    """One figure of a result by what it shows.

    Args:
        result: what was found.
        what: ``"causes"``, ``"tool"``, or as for :func:`draw_fit`.

    Raises:
        InputError: for a figure that there is not, or not of this result.
    """
    base = result.before
    before = base.predicted if result.improved else base.predicted_before
    ways = _of_fit(result.after, before)
    if result.effects:
        ways["causes"] = lambda: draw_causes(result.effects)
    if (space := result.workspace) is not None:
        ways["tool"] = lambda: draw_vectors(space)
    return _drawn(ways, what)


def draw_fit(estimate: Estimate, what: str) -> Drawing:
    """One figure of a fit by what it shows.

    Args:
        estimate: the fit.
        what: ``"residuals"``, ``"readings"``, ``"parameters"`` or ``"correlations"``.

    Raises:
        InputError: for a figure that there is not.
    """
    return _drawn(_of_fit(estimate, estimate.predicted_before), what)


def _of_fit(estimate: Estimate, before: Array) -> Ways:
    return {
        "residuals": lambda: draw_residuals(estimate, before),
        "readings": lambda: draw_readings(estimate, before),
        "parameters": lambda: draw_parameters(estimate),
        "correlations": lambda: draw_correlations(estimate),
    }


def _drawn(ways: Ways, what: str) -> Drawing:
    if what not in ways:
        raise InputError(f"this result has no figure {what!r}: it has {', '.join(ways)}")
    with applied():
        return ways[what]()
