"""Data of the page's sections."""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any

from orthoglide.control import withholding_reason
from orthoglide.effects.words import toward
from orthoglide.geometry import LEGS
from orthoglide.numerals import compact
from orthoglide.report.fit_sentences import weak_sentences
from orthoglide.report.rows import millimetres
from orthoglide.report.sentences import (
    NOT_VARIED,
    undetected_effects,
    unvaried_effects,
    unvaried_words,
)
from orthoglide.result import BudgetItem, Result, SetupResidual, Workspace
from orthoglide.text import listed, sentence

Data = dict[str, Any]

_MOST_ITEMS = 12  # rows of the budget
_MIN_SHARE = 0.01  # smallest share of the tool's error for which a row of the budget is shown


def largest_residual(residual: SetupResidual) -> str:
    """Return the largest residual of a mounting; of one posture with its direction."""
    if residual.leg < 0 or not residual.posture:
        return f"{compact(residual.most * 1e3, 2)} {residual.unit}"
    direction = toward(LEGS[residual.axis], residual.most)
    return f"{compact(abs(residual.most) * 1e3, 2)} mm toward {direction}"


def score_data(result: Result) -> Data:
    """Return the effects specific to a campaign, and the share of points within their interval."""
    inside = result.tcp["translation"].inside if result.tcp else math.nan
    return {
        "own": listed([n.replace("_", " ") + "s" for n in result.request.own]),
        "inside": f"{inside:.0%}" if math.isfinite(inside) else "",
    }


def budget(result: Result) -> Data:
    """Return the error budget, largest gain by a repair first."""
    ambiguous = {c.name for c in result.effects if len(c.explanations) > 1}
    ambiguous |= {one.in_budget for one in result.located if len(one.members) > 1}
    named = {item.cause for item in result.budget if not item.rest}
    items = [item for item in result.budget if item.share >= _MIN_SHARE or not item.rest]
    items = items[:_MOST_ITEMS]
    return {
        "rows": [(item, item.words + _budget_note(item, named, ambiguous)) for item in items],
        "others": len(result.budget) - len(items),
    }


def _budget_note(item: BudgetItem, named: Collection[str], ambiguous: Collection[str]) -> str:
    """Return the words after the name of a row of the budget."""
    if item.rest:
        return ": the others of its kind" if item.cause in named else ""
    return ", or a cause that these readings cannot tell from it" if item.cause in ambiguous else ""


def controller(result: Result) -> Data:
    """Return numbers for the controller, or why the verdict does not support them."""
    spec, numbers, reason = result.machine.spec, result.numbers, withholding_reason(result.machine)
    catalogue = result.catalogue
    zeros = any(catalogue.effect_of(name).controller == "zero" for name in spec.parameters)
    curves = [found.members[0] for found in result.located]
    return {
        "drives": numbers.drives if zeros else (),
        "withheld": " ".join(result.cautions) or (sentence(reason) if reason else ""),
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


def workspace(result: Result, space: Workspace) -> Data:
    """Return the TCP's error over the workspace and its uncertainty."""
    stages = space.stages(result.improved)
    sizes = [(what, *millimetres([float(v.mean()), float(v.max())])) for what, v in stages]
    return {"rows": sizes}


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
    return {
        "sentences": weak_sentences(result.weak, result.catalogue),
        "effects": undetected_effects(result),
        "unexcited": unvaried_effects(result),
        "not_varied": NOT_VARIED,
        "sides": sentence(words) if (words := unvaried_words(result)) else "",
        # Not if the report states above that no more readings of a dial on a leg help.
        "second_place": _has_one_place(result)
        and not any(suggestion.hopeless for suggestion in result.next_measurements),
        "owned": ",".join(result.instruments),
        "machine": result.request.machine_option,
    }


def _has_one_place(result: Result) -> bool:
    """Whether dials read some leg at a single place along it."""
    setups = [setup for campaign in result.request.campaigns for setup in campaign.setups]
    places = {(setup.leg, round(gauge, 3)) for setup in setups for gauge in setup.gauges}
    return 1 in Counter(leg for leg, _ in places).values()


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
