"""All figures of a result."""

from __future__ import annotations

from collections.abc import Callable

from orthoglide.effects import Catalogue
from orthoglide.errors import InputError
from orthoglide.figures.causes import draw_causes, draw_located, draw_signatures
from orthoglide.figures.readings import draw_readings, draw_residuals
from orthoglide.figures.style import Drawing, applied
from orthoglide.figures.values import draw_correlations, draw_parameters
from orthoglide.figures.workspace import draw_vectors, draw_workspace
from orthoglide.frames import Framed
from orthoglide.geometry import Array
from orthoglide.numerals import ByUnit
from orthoglide.result import Correlations, ReadingsShown, Result

Ways = dict[str, Callable[[], Drawing]]


def draw(result: Result) -> list[Drawing]:
    """All figures of a result."""
    causes, ways = result.effects, _of_result(result)
    with applied():
        drawings = [draw_causes(causes)] if causes else []
        drawings += [draw_signatures(c, result.readings, k) for k, c in enumerate(causes, start=1)]
        drawings += [draw_located(f, k) for k, f in enumerate(result.located, start=1)]
        drawings += [ways["residuals"](), ways["readings"]()]
        if result.workspace is None:
            return [*drawings, ways["parameters"](), ways["correlations"]()]
        return [*drawings, draw_workspace(result.workspace, result.improved)]


def draw_one(result: Result, what: str) -> Drawing:
    """One figure of a result by what it shows.

    Args:
        result: what was found.
        what: ``"causes"``, ``"tool"``, or as for :func:`draw_fit`.

    Raises:
        InputError: for a figure that there is not, or not of this result.
    """
    ways = _of_result(result)
    if result.effects:
        ways["causes"] = lambda: draw_causes(result.effects)
    if (space := result.workspace) is not None:
        ways["tool"] = lambda: draw_vectors(space)
    return _drawn(ways, what)


def draw_fit(
    read: ReadingsShown,
    noise: ByUnit,
    found: Framed,
    correlations: Correlations,
    catalogue: Catalogue,
    what: str,
) -> Drawing:
    """One figure of a fit by what it shows.

    Args:
        read: the readings, and what the nominal machine and the fit predict of them.
        noise: standard deviation of one of them.
        found: the fit, whose columns are what it found.
        correlations: of that.
        catalogue: of its effects.
        what: ``"residuals"``, ``"readings"``, ``"parameters"`` or ``"correlations"``.

    Raises:
        InputError: for a figure that there is not.
    """
    return _drawn(_ways(read, read.nominal, noise, found, correlations, catalogue), what)


def _of_result(result: Result) -> Ways:
    read = result.readings
    before = read.before if result.improved else read.nominal
    return _ways(
        read, before, result.noise.single_reading, result, result.correlations, result.catalogue
    )


def _ways(
    read: ReadingsShown,
    before: Array,
    noise: ByUnit,
    found: Framed,
    correlations: Correlations,
    catalogue: Catalogue,
) -> Ways:
    return {
        "residuals": lambda: draw_residuals(read, before, noise),
        "readings": lambda: draw_readings(read, before),
        "parameters": lambda: draw_parameters(found.columns, catalogue),
        "correlations": lambda: draw_correlations(correlations.parameters, correlations.matrix),
    }


def _drawn(ways: Ways, what: str) -> Drawing:
    if what not in ways:
        raise InputError(f"this result has no figure {what!r}: it has {', '.join(ways)}")
    with applied():
        return ways[what]()
