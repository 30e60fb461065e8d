"""The report: one self-contained page with a first screen and sections below.

A section is a template ``sections/<name>.html.j2`` and its data, which are never markup. The first
screen states the finding, the errors of the tool, and what to do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import orthoglide.report.sections as sections
from orthoglide import __version__
from orthoglide.control import withholding_reason
from orthoglide.figures.style import Drawing
from orthoglide.numerals import compact, plain, probability, signed, with_sigma
from orthoglide.report.claims import SOMETHING_ELSE_WRONG, claims, lower_first
from orthoglide.report.sentences import (
    evidence,
    finding_text,
    further_warnings,
    gain_words,
    meaning,
)
from orthoglide.result import Result
from orthoglide.text import listed, sentence

if TYPE_CHECKING:
    from jinja2 import Environment

    from orthoglide.accuracy import ExpectedError

_VALIDATION_ROLES = {"holdout": "held out to judge by", "tcp": "measured at the TCP to judge by"}
_UNFOLDED = ("finding", "left", "firmware", "controller", "changes")  # sections shown open


@dataclass(frozen=True)
class Section:
    """One section of the page."""

    template: str  # name under `templates/sections`, and its anchor
    title: str  # its heading; empty for the verdict at the top
    data: Mapping[str, Any]  # values for the template besides the result

    @property
    def folded(self) -> bool:
        """Whether the section is closed at first."""
        return self.template not in _UNFOLDED


def page(result: Result, drawings: Sequence[Drawing], sheet: str) -> str:
    """Return the report as HTML; ``sheet`` is the text of ``next_measurements.csv``, empty if
    nothing is proposed.
    """
    return render_template(
        "page.html.j2",
        result=result,
        title="What is wrong with this machine" if result.searches else "Calibration report",
        subtitle=_subtitle(result),
        sections=list(_sections(result, {d.name: d for d in drawings}, sheet)),
        version=__version__,
        command=result.request.command,
    )


def _sections(result: Result, figures: Mapping[str, Drawing], sheet: str) -> Iterator[Section]:
    searches = result.searches
    yield Section("finding", "", finding(result))
    if result.blunders:
        yield Section("faults", "Faults of the data", sections.faults(result))
    if searches and not result.stands:
        yield Section("left", "What is left", sections.residual_data(result))
    if result.corrections is not None:
        yield Section("firmware", "Numbers for the firmware", sections.firmware(result))
    controller = {"drives": ()} if result.firmware else sections.controller(result)
    if controller["drives"]:
        yield Section("controller", "Numbers for the controller", controller)
    yield Section("judged", "Before and after", sections.score_data(result, figures))
    if searches:
        yield Section("causes", "Causes, and how sure they are", sections.causes(result))
    if result.located:
        yield Section("located", "Where it is", sections.located(result, figures))
    if result.effects:
        predictions = sections.prediction_data(result, figures)
        yield Section("apart", "What each cause predicts", predictions)
    if searches:
        yield Section("next", "What to measure next", sections.next_readings_data(result, sheet))
    if result.budget:
        yield Section("budget", "Error budget", sections.budget(result))
    if result.workspace is not None:
        space = sections.workspace(result, result.workspace, figures)
        yield Section("workspace", "The TCP over the workspace", space)
    yield Section("values", "What was identified", sections.values(result, figures))
    yield Section(
        "readings", "Readings and fit, setup by setup", sections.readings(result, figures)
    )
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
    count, counts = sum(map(len, request.campaigns)), []
    if count:
        setups = sum(len(given.setups) for given in request.campaigns)
        counts.append(f"{count} readings in {setups} setups")
    tool_count = sum(len(given) for given in request.points if not given.by_point)
    point_count = sum(len(given.points().command) for given in request.points if given.by_point)
    if tool_count:
        counts.append(f"{tool_count} readings of the tool")
    if point_count:
        counts.append(f"{point_count} TCP points")
    return "; ".join([f"{files}: {listed(counts)}", *validation])


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
    """Return the data of the first screen: verdict, claims, tool errors, actions, and cautions."""
    after, searches = result.after, result.searches
    lacking = not searches and after.sigma_scale > 1
    return {
        "first": result.contradicted or (result.firmware.first if result.firmware else ""),
        "word": result.word,
        "meaning": sentence(meaning(result)),
        "claims": claims(result),
        "drawing": result.picture.svg(),
        "options": len(result.picture.options),
        "dials": bool(result.picture.dials),
        "text": "" if result.found else finding_text(result),
        "more": SOMETHING_ELSE_WRONG if result.word == "partial" else "",
        "evidence": evidence(result) if searches else "",
        "averaged": any(cause.rivals for cause in result.effects),
        "tiles": tiles(result),
        "printer": result.corrections is not None,
        "open": after.scores.left.said() if not result.stands or lacking else "",
        "legs": bool(result.request.campaigns),
        "loses": result.loses,
        "actions": result.actions,
        "sheet": result.next_sheet is not None,
        "most": MAX_LISTED,
        "cautions": result.further_cautions,
        "warnings": [sentence(w) for w in further_warnings(result)],
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

_FILTERS = (sentence, listed, lower_first, gain_words, compact, plain, signed, probability,
            with_sigma)  # fmt: skip


def render_template(template: str, **data: Any) -> str:
    """Return a template of the folder ``templates`` filled with its data; missing data are an
    error. Its filters are the functions in ``_FILTERS``, and ``fixed``.
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
    environment.filters.update({word.__name__: word for word in _FILTERS}, fixed="{:.{}f}".format)
    return environment
