"""The report: one self-contained page with a first screen and sections below.

A section is a template ``sections/<name>.html.j2`` and its data, which are never markup. The first
screen states the finding, the errors of the tool, and what to do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

import orthoglide.report.sections as sections
from orthoglide import __version__
from orthoglide.control import withholding_reason
from orthoglide.figures.readings import MAX_DRAWN
from orthoglide.figures.style import Drawing
from orthoglide.numerals import compact, plain, probability, signed, with_sigma
from orthoglide.report.claims import SOMETHING_ELSE_WRONG, claims
from orthoglide.report.fit_sentences import base_effects
from orthoglide.report.rows import (
    POSSIBLE_TITLES,
    parameter_rows,
    possible_rows,
    probable_candidates,
    score_rows,
)
from orthoglide.report.sentences import (
    evidence,
    finding_text,
    further_warnings,
    gain_words,
    meaning,
    no_action_text,
)
from orthoglide.result import Result
from orthoglide.result.findings import FAULT_NAMES
from orthoglide.text import listed, lower_first, sentence

if TYPE_CHECKING:
    from jinja2 import Environment

    from orthoglide.accuracy import ExpectedError

_VALIDATION_ROLES = {"holdout": "held out to judge by", "tcp": "measured at the TCP to judge by"}


@dataclass(frozen=True)
class Section:
    """One section of the page."""

    template: str  # name under `templates/sections`, and its anchor
    title: str  # its heading; empty for the verdict at the top
    # values for the template besides the result and its figures
    data: Mapping[str, Any] = field(default_factory=dict)
    folded: bool = True  # whether the section is closed at first


def page(result: Result, drawings: Sequence[Drawing], sheet: str) -> str:
    """Return the report as HTML; ``sheet`` is the text of ``next_measurements.csv``, empty if
    nothing is proposed.
    """
    return render_template(
        "page.html.j2",
        result=result,
        figures={drawing.name: drawing for drawing in drawings},
        title="What is wrong with this machine" if result.searches else "Calibration report",
        subtitle=_subtitle(result),
        sections=list(_sections(result, sheet)),
        version=__version__,
        command=result.request.command,
    )


def _sections(result: Result, sheet: str) -> Iterator[Section]:
    searches = result.searches
    yield Section("finding", "", finding(result), folded=False)
    if result.blunders:
        yield Section("faults", "Faults of the data")
    if searches and not result.stands:
        yield Section("left", "The residual", folded=False)
    if result.corrections is not None:
        yield Section("firmware", "Numbers for the firmware", folded=False)
    controller = {"drives": ()} if result.firmware else sections.controller(result)
    if controller["drives"]:
        yield Section("controller", "Numbers for the controller", controller, folded=False)
    yield Section("judged", "Before and after", sections.score_data(result))
    if searches:
        yield Section("causes", "Causes, and how sure they are")
    if result.located:
        yield Section("located", "Where it is")
    if searches:
        yield Section("next", "What to measure next", sections.next_readings_data(result, sheet))
    if result.budget:
        yield Section("budget", "Error budget", sections.budget(result))
    if result.workspace is not None:
        space = sections.workspace(result, result.workspace)
        yield Section("workspace", "The TCP over the workspace", space)
    values = sections.values(result)  # the finding of an identification
    yield Section("values", "What was identified", values, folded=searches)
    yield Section("readings", "Readings and fit, setup by setup")
    yield Section("unseen", "What these readings cannot tell", sections.unseen(result))
    yield Section("method", "How this was computed", sections.method(result))


def _subtitle(result: Result) -> str:
    request = result.request
    files = listed(i["file"] for i in request.inputs if i.get("role", "fit_tcp") == "fit_tcp")
    validation = [
        f"{i['file']} {_VALIDATION_ROLES[i['role']]}"
        for i in request.inputs
        if i.get("role") in _VALIDATION_ROLES
    ]
    points = request.points
    counts = {
        f"readings in {sum(len(c.setups) for c in request.campaigns)} setups":
            sum(map(len, request.campaigns)),
        "readings of the tool": sum(len(p) for p in points if not p.by_point),
        "TCP points": sum(len(p.points().command) for p in points if p.by_point),
    }  # fmt: skip
    counted = listed(f"{count} {what}" for what, count in counts.items() if count)
    return "; ".join([f"{files}: {counted}", *validation])


# --- The first screen -----------------------------------------------------------------------

MAX_LISTED = 5
"""Number of rivals shown before the others, which are folded away."""

_STAGES = {
    "now": "The tool now",
    "zeros": "With zeros corrected",
    "zeros_and_lengths": "And {bar} lengths entered",
    "compensated": "With commands compensated",
}
_FIRMWARE_STAGES = ("With the firmware's numbers", "With the new ones")


@dataclass(frozen=True)
class Tile:
    """Error of the tool at one stage of correction."""

    what: str  # the stage
    size: str  # the error in millimetres
    lines: tuple[str, str]  # text below


def finding(result: Result) -> sections.Data:
    """Return the words of the first screen that are not those of claims, tiles and actions."""
    return {
        "first": result.contradicted or (result.firmware.first if result.firmware else ""),
        "text": "" if result.found else finding_text(result),
        "more": SOMETHING_ELSE_WRONG if result.word == "partial" else "",
        "evidence": evidence(result),
        "averaged": any(cause.rivals for cause in result.effects),
        "open": "" if result.stands else result.after.scores.left.said(),
        "sheet": result.next_sheet is not None,
    }


def tiles(result: Result) -> list[Tile]:
    """Return the tool's mean error now and after each correction; of a printer the residual of its
    firmware's equations.
    """
    if (corrections := result.corrections) is not None:
        shown = [
            Tile(what, f"{size * 1e3:.3f}", ("of the heights", "that were read, rms"))
            for what, size in zip(_FIRMWARE_STAGES, corrections.height, strict=True)
        ]
        enter = result.stands and not corrections.keep and not withholding_reason(result.machine)
        return shown if enter else shown[:1]
    expected = result.numbers.expected
    stages = ("now", "zeros") if not result.stands and result.searches else _STAGES
    bar = result.numbers.names.bar
    shown, last = [], math.inf
    for name in stages:
        error = expected[name]
        if abs(error.shape - last) > error.shape_sigma:
            shown.append(_tile(_STAGES[name].format(bar=bar), error))
            last = error.shape
    return shown


def _tile(stage: str, error: ExpectedError) -> Tile:
    shape, _, sigma = error.words.partition(" ± ")
    sigma_words = f"± {sigma} " if sigma else ""
    return Tile(
        stage, shape, (f"{sigma_words}in a workpiece", f"all shifted by {error.place_words} mm")
    )


# --- Templates ------------------------------------------------------------------------------

_FILTERS = (
    sentence, listed, lower_first, gain_words, compact, plain, signed, probability, with_sigma,
    meaning, no_action_text, claims, tiles, further_warnings,
    base_effects, parameter_rows, score_rows, possible_rows,
    probable_candidates,
    sections.largest_residual, sections.reason_not_to_enter,
)  # fmt: skip


def render_template(template: str, **data: Any) -> str:
    """Return a template of the folder ``templates`` filled with its data; missing data are an
    error. Its filters are the functions in ``_FILTERS``, ``fixed`` and ``fault_name``.
    """
    return _environment().get_template(template).render(**data)


@cache
def _environment() -> Environment:
    """Return the environment of the templates, each compiled once."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("orthoglide.report"), undefined=StrictUndefined, autoescape=True,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters.update(
        {word.__name__: word for word in _FILTERS}, fixed="{:.{}f}".format,
        fault_name=FAULT_NAMES.get,
    )  # fmt: skip
    environment.globals.update(
        possible_titles=POSSIBLE_TITLES, max_drawn=MAX_DRAWN, most_listed=MAX_LISTED
    )
    return environment
