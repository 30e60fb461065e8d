"""The report: one self-contained page with a first screen and sections below.

A section is a template ``sections/<name>.html.j2`` and its data, which are never markup. The first
screen states the finding, the errors of the tool, and what to do.
"""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orthoglide import __version__
from orthoglide.control import withholding_reason
from orthoglide.effects.words import toward
from orthoglide.figures.draw import MAX_DRAWN
from orthoglide.figures.style import Drawing
from orthoglide.geometry import LEGS
from orthoglide.numerals import compact, plain, probability, signed, with_sigma
from orthoglide.report.claims import SOMETHING_ELSE_WRONG, claims
from orthoglide.report.rows import (
    POSSIBLE_TITLES,
    base_effects,
    millimetres,
    parameter_rows,
    possible_rows,
    probable_candidates,
    score_rows,
    weak_sentences,
)
from orthoglide.report.sentences import (
    NOT_VARIED,
    evidence,
    finding_text,
    further_warnings,
    gain_words,
    meaning,
    no_action_text,
    undetected_effects,
    unvaried_effects,
    unvaried_words,
)
from orthoglide.result import Result, SetupResidual
from orthoglide.result.findings import FAULT_NAMES
from orthoglide.text import listed, lower_first, sentence

if TYPE_CHECKING:
    from jinja2 import Environment

Data = dict[str, Any]

_MOST_ITEMS = 12  # rows of the budget
_MIN_SHARE = 0.01  # smallest share of the tool's error for which a row of the budget is shown


def largest_residual(residual: SetupResidual) -> str:
    """Return the largest residual of a mounting; of one posture with its direction."""
    if residual.leg < 0 or not residual.posture:
        return f"{compact(residual.most * 1e3, 2)} {residual.unit}"
    direction = toward(LEGS[residual.axis], residual.most)
    return f"{compact(abs(residual.most) * 1e3, 2)} mm toward {direction}"


def budget(result: Result) -> Data:
    """Return the error budget, largest gain by a repair first."""
    ambiguous = {c.name for c in result.effects if len(c.explanations) > 1}
    ambiguous |= {one.in_budget for one in result.located if len(one.members) > 1}
    named = {item.cause for item in result.budget if not item.rest}
    items = [item for item in result.budget if item.share >= _MIN_SHARE or not item.rest]
    rows = []
    for item in items[:_MOST_ITEMS]:
        note = ": the others of its kind" * (item.rest and item.cause in named)
        if not item.rest and item.cause in ambiguous:
            note = ", or a cause that these readings cannot tell from it"
        rows.append((item, item.words + note))
    return {"rows": rows, "others": len(result.budget) - len(rows)}


def controller(result: Result) -> Data:
    """Return numbers for the controller, or why the verdict does not support them."""
    spec, numbers, reason = result.machine.spec, result.numbers, withholding_reason(result.machine)
    catalogue = result.catalogue
    zeros = any(catalogue.effect_of(name).controller == "zero" for name in spec.parameters)
    curves = [found.members[0] for found in result.located]
    return {
        "drives": numbers.drives if zeros else (),
        "withheld": (" ".join(result.cautions) or sentence(reason)) if reason else "",
        "counts": numbers.names.slide_end_words[1][1],
        "standard": spec.controller.sign == (1, 1, 1) and not any(spec.controller.zero),
        "beyond": listed(c.description for c in curves if not c.of_machine),
    }


def reason_not_to_enter(result: Result) -> tuple[str, str]:
    """Return that numbers are not to be entered, and why, a clause each; empty if they may be."""
    not_yet = "Do not enter these numbers yet"
    if not result.stands:
        return not_yet, "a residual remains that nothing explains, and it would distort them"
    if result.cautions:
        return not_yet, "the verdict warns of what would distort them"
    firmware = result.firmware
    if firmware is None or firmware.corrections is None or not firmware.corrections.keep:
        return "", ""
    return not_yet if firmware.again else "Do not enter new numbers", firmware.corrections.keep


_AIMS = {
    "separate": "To decide between causes",
    "narrow": "To determine weakly seen values better",
    "trace": "To trace the residual",
}


def next_readings_data(result: Result, sheet: str) -> Data:
    """Return the readings to take next, with the sheet as a link."""
    by_aim = dict[str, list[str]]()
    others, hopeless = list[str](), list[str]()
    for suggestion in result.next_measurements:
        reason = sentence(suggestion.reason)
        if suggestion.readings:
            by_aim.setdefault(_AIMS[suggestion.aim], []).append(reason)
        if suggestion.hopeless:
            hopeless.append(reason)
        elif suggestion.other_instrument:
            others.append(reason)
    data = base64.b64encode(sheet.encode()).decode()
    link = f"data:text/csv;charset=utf-8;base64,{data}" if sheet else ""
    return {"suggestions": by_aim, "others": others, "hopeless": hopeless, "link": link}


def values(result: Result) -> Data:
    """Return what the identified values do not say of themselves."""
    fit, effect_of = result.after, result.catalogue.effect_of
    freed = {effect_of(n).name for n in result.identified}
    nonzero = (effect_of(n).name for n, value in result.machine.values.items() if value)
    effect_words = result.catalogue.legs.effect_words
    others = dict.fromkeys(effect_words(name) for name in nonzero if name not in freed)
    return {
        "others": listed(others),
        "dials": any(effect_of(n).of_dial for n in result.identified),
        "scale": f"{fit.sigma_scale:.2g}" if fit.sigma_scale > 1 else "",
    }


def unseen(result: Result) -> Data:
    """Return what the readings cannot distinguish, and what they cannot detect."""
    setups = [setup for campaign in result.request.campaigns for setup in campaign.setups]
    places = {(setup.leg, round(gauge, 3)) for setup in setups for gauge in setup.gauges}
    return {
        "sentences": weak_sentences(result.weak, result.catalogue),
        "effects": undetected_effects(result),
        "unexcited": unvaried_effects(result),
        "not_varied": NOT_VARIED,
        "sides": sentence(words) if (words := unvaried_words(result)) else "",
        # Dials read some leg at a single place along it, unless the report states above that no
        # more readings of a dial on a leg help.
        "second_place": 1 in Counter(leg for leg, _ in places).values()
        and not any(suggestion.hopeless for suggestion in result.next_measurements),
        "owned": ",".join(result.instruments),
        "machine": result.request.machine_option,
    }


_METHODS = {
    "nlp": "one nonlinear programme that carries the loop closures of every posture as constraints",
    "posterior": "the posterior of everything that could be wrong, about its own mean",
    "nested": "Newton steps on the parameters, every posture's loops closed at each step",
    "reduction": "the analytic reduction of the mechanism (three spheres)",
}
_SOURCES = {
    "declared": "as declared",
    "machine": "from the machine file, or the usual figure of such instruments where it has none",
    "repeats": "from the scatter of the repeats",
}


def method(result: Result) -> Data:
    """Return how the result was computed, from which files, and how to repeat it."""
    observations = (setup.observation for setup in result.request.setups)
    return {
        "machine": Path(result.request.machine.spec.file).name or "the nominal Orthoglide",
        "mechanism": result.catalogue.legs.in_layout_words(
            "the platform on three pairs of bars, each pair on a carriage"
        ),
        "method": _METHODS[result.before.method],
        "source": _SOURCES[result.noise.source],
        "fitted": {o.instrument_phrase: o.nuisance_summary for o in observations},
    }


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
    inputs, points = result.request.inputs, result.request.points
    files = listed(i["file"] for i in inputs if i.get("role", "fit_tcp") == "fit_tcp")
    validation = [
        f"{i['file']} {_VALIDATION_ROLES[i['role']]}"
        for i in inputs
        if i.get("role") in _VALIDATION_ROLES
    ]
    campaigns = result.request.campaigns
    counts = {
        f"readings in {sum(len(c.setups) for c in campaigns)} setups": sum(map(len, campaigns)),
        "readings of the tool": sum(len(p) for p in points if not p.by_point),
        "TCP points": sum(len(p.points().command) for p in points if p.by_point),
    }
    counted = listed(f"{count} {what}" for what, count in counts.items() if count)
    return render_template(
        "page.html.j2",
        result=result,
        figures={drawing.name: drawing for drawing in drawings},
        title="What is wrong with this machine" if result.searches else "Calibration report",
        subtitle="; ".join([f"{files}: {counted}", *validation]),
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
    zeros = {"drives": ()} if result.firmware else controller(result)
    if zeros["drives"]:
        yield Section("controller", "Numbers for the controller", zeros, folded=False)
    inside = result.tcp["translation"].inside if result.tcp else math.nan
    scores = {
        "own": listed([n.replace("_", " ") + "s" for n in result.request.own]),
        "inside": f"{inside:.0%}" if math.isfinite(inside) else "",
    }
    yield Section("judged", "Before and after", scores)
    if searches:
        yield Section("causes", "Causes, and how sure they are")
    if result.located:
        yield Section("located", "Where it is")
    if searches:
        yield Section("next", "What to measure next", next_readings_data(result, sheet))
    if result.budget:
        yield Section("budget", "Error budget", budget(result))
    if result.workspace is not None:
        stages = result.workspace.stages(result.improved)
        sizes = [(what, *millimetres([float(v.mean()), float(v.max())])) for what, v in stages]
        yield Section("workspace", "The TCP over the workspace", {"rows": sizes})
    identified = values(result)  # the finding of an identification
    yield Section("values", "What was identified", identified, folded=searches)
    yield Section("readings", "Readings and fit, setup by setup")
    yield Section("unseen", "What these readings cannot tell", unseen(result))
    yield Section("method", "How this was computed", method(result))


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


def finding(result: Result) -> Data:
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
            shape, _, sigma = error.words.partition(" ± ")
            within = f"± {sigma} " * bool(sigma) + "in a workpiece"
            lines = within, f"all shifted by {error.place_words} mm"
            shown.append(Tile(_STAGES[name].format(bar=bar), shape, lines))
            last = error.shape
    return shown


# --- Templates ------------------------------------------------------------------------------

_FILTERS = (
    sentence, listed, lower_first, gain_words, compact, plain, signed, probability, with_sigma,
    meaning, no_action_text, claims, tiles, further_warnings,
    base_effects, parameter_rows, score_rows, possible_rows,
    probable_candidates,
    largest_residual, reason_not_to_enter,
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
