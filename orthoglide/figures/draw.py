"""All figures of a result, and one of a result or a fit by its name."""

from __future__ import annotations

from collections.abc import Callable

from orthoglide.effects import Catalogue
from orthoglide.errors import check_word
from orthoglide.figures.causes import draw_located, draw_signatures
from orthoglide.figures.readings import draw_readings, draw_residuals
from orthoglide.figures.style import Drawing, applied
from orthoglide.figures.values import draw_parameters
from orthoglide.figures.workspace import draw_workspace
from orthoglide.frames import Framed
from orthoglide.geometry import Array
from orthoglide.numerals import ByUnit
from orthoglide.result import ReadingsShown, Result


def draw(result: Result) -> list[Drawing]:
    """Return all figures of a result."""
    with applied():
        causes = enumerate(result.effects, start=1)
        drawings = [draw_signatures(cause, result.readings, k) for k, cause in causes]
        drawings += [draw_located(f, k) for k, f in enumerate(result.located, start=1)]
        return drawings + [made() for made in _figures(result).values()]


def draw_one(result: Result, what: str) -> Drawing:
    """Return one figure of a result: ``"residuals"``, ``"readings"``, ``"workspace"``, or after
    ``identify`` ``"parameters"``.

    Raises:
        InputError: for a figure that there is not, or not of this result.
    """
    return _drawn(_figures(result), what)


def draw_fit(
    read: ReadingsShown, noise: ByUnit, found: Framed, catalogue: Catalogue, what: str
) -> Drawing:
    """Return one figure of a fit: ``"residuals"``, ``"readings"`` or ``"parameters"``.

    Args:
        read: the readings, and what the nominal machine and the fit predict of them.
        noise: standard deviation of one of them.
        found: the fit, whose columns are what it found.
        catalogue: of its effects.
        what: the figure.

    Raises:
        InputError: for a figure that there is not.
    """
    return _drawn(_of_fit(read, read.nominal, noise, found, catalogue), what)


_Figures = dict[str, Callable[[], Drawing]]


def _figures(result: Result) -> _Figures:
    read, space = result.readings, result.workspace
    before = read.before if result.improved else read.nominal
    noise = result.noise.single_reading
    found = _of_fit(read, before, noise, result, result.catalogue)
    if space is not None:
        del found["parameters"]
        found["workspace"] = lambda: draw_workspace(space, result.improved)
    return found


def _of_fit(
    read: ReadingsShown, before: Array, noise: ByUnit, found: Framed, catalogue: Catalogue
) -> _Figures:
    return {
        "residuals": lambda: draw_residuals(read, before, noise),
        "readings": lambda: draw_readings(read, before),
        "parameters": lambda: draw_parameters(found.columns, catalogue),
    }


def _drawn(figures: _Figures, what: str) -> Drawing:
    check_word("figure", what, figures)
    with applied():
        return figures[what]()
