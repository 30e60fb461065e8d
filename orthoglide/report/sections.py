"""Sections of the page: what was found (faults, causes, and what they explain), and what follows
(numbers, next readings, workspace, values, method).
"""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from orthoglide.control import RULE, withholding_reason
from orthoglide.effects.words import toward
from orthoglide.figures.causes import drawn_explanations
from orthoglide.figures.readings import MAX_DRAWN
from orthoglide.figures.style import Drawing
from orthoglide.geometry import LEGS
from orthoglide.machine_file import MachineFile
from orthoglide.numerals import compact
from orthoglide.observations import Setup
from orthoglide.report.embed import inline_panels, inline_svg
from orthoglide.report.identified import base_effects, weak_sentences
from orthoglide.report.rows import (
    POSSIBLE_TITLES,
    millimetres,
    parameter_rows,
    possible_rows,
    probable_candidates,
    score_rows,
)
from orthoglide.report.sentences import undetected_effects, unvaried_effects, unvaried_words
from orthoglide.result import BudgetItem, Result, SetupResidual, Workspace
from orthoglide.text import listed, sentence

Data = dict[str, Any]
Figures = Mapping[str, Drawing]

_MOST_ITEMS = 12
_MIN_SHARE = 0.01  # of the tool's error: an item of the budget that gains less is not shown
_MOST_SHAPES = 5  # known causes named as ruled out

_FAULTS = {
    "outlier": "a reading out of line",
    "knocked_stand": "a stand that was knocked",
    "zeroed": "a dial set to zero anew at each repeat",
    "command": "a posture that is not where its command says",
    "sign": "a dial that counted the other way",
    "label": "a setup of another leg or direction",
    "exchanged_labels": "two setups exchanged",
    "shifted": "readings a row too late or too early",
    "unit": "a wrong unit",
    "turns": "readings whole turns of the hand off",
    "stuck": "a dial that stuck",
    "scatter": "visits that do not repeat",
    "moved": "an instrument that was moved",
}


def faults(result: Result) -> Data:
    """Return the data faults with residuals with and without each."""
    return {"rows": [(_FAULTS[b.kind], b) for b in result.blunders]}


def residual_data(result: Result) -> Data:
    """Return residuals of every mounting, and the most probable causes if nothing was found."""
    return {
        "rows": [(rest, _largest_residual(rest)) for rest in result.left.mountings],
        "titles": POSSIBLE_TITLES,
        "possible": possible_rows(result),
    }


def _largest_residual(rest: SetupResidual) -> str:
    if rest.leg < 0 or not rest.posture:
        return f"{compact(rest.most * 1e3, 2)} {rest.unit}"
    way = toward(LEGS[rest.axis], rest.most)
    return f"{compact(abs(rest.most) * 1e3, 2)} mm toward {way}"


def score_data(result: Result, figures: Figures) -> Data:
    """Return figures of merit of the nominal machine, before and after."""
    inside = result.tcp["translation"].inside if result.tcp else math.nan
    return {
        "rows": score_rows(result),
        "figure": inline_svg(figures["residuals"]),
        "own": listed([n.replace("_", " ") + "s" for n in result.request.own]),
        "inside": f"{inside:.0%}" if math.isfinite(inside) else "",
        "base": base_effects(result),
    }


def causes(result: Result) -> Data:
    """Return the candidates and how probable they are."""
    near = probable_candidates(result)
    return {
        "added": {c.name for c in result.effects} | {f.name for f in result.located},
        "weighed": near,
        "others": len(result.candidates) - len(near),
    }


def located(result: Result, figures: Figures) -> Data:
    """Return free-form errors with their curves and the causes that they resemble."""
    places = [
        (one.words, one, inline_panels(figures[f"located-{k}"]))
        for k, one in enumerate(result.located, start=1)
    ]
    return {"places": places, "most": _MOST_SHAPES}


def budget(result: Result) -> Data:
    """Return the error budget, the largest gain by a repair first."""
    several = {c.name for c in result.effects if len(c.explanations) > 1}
    classes = [one for one in result.located if len(one.members) > 1]
    several |= {one.in_budget for one in classes}
    named = {item.cause for item in result.budget if not item.rest}
    shown = [item for item in result.budget if item.share >= _MIN_SHARE or not item.rest]
    shown = shown[:_MOST_ITEMS]
    return {
        "rows": [(item, item.words + _budget_note(item, named, several)) for item in shown],
        "others": len(result.budget) - len(shown),
    }


def _budget_note(item: BudgetItem, named: Collection[str], several: Collection[str]) -> str:
    """Return what a row of the budget contains besides its name, behind the name."""
    if item.rest:
        return ": the others of its kind" if item.cause in named else ""
    return ", or a cause that these readings cannot tell from it" if item.cause in several else ""


def prediction_data(result: Result, figures: Figures) -> Data:
    """Return what each cause and its rivals predict of the readings."""
    every = enumerate(result.effects, start=1)
    causes = [
        (c.chosen.words, drawn_explanations(c), c.others, inline_panels(figures[f"signatures-{k}"]))
        for k, c in every
    ]
    return {"causes": causes}


def readings(result: Result, figures: Figures) -> Data:
    """Return readings and fit, setup by setup."""
    most = max(len(one.rows) for one in result.readings.mountings)
    thinned = MAX_DRAWN if most > MAX_DRAWN else 0
    return {"panels": inline_panels(figures["readings"]), "thinned": thinned}


def controller(result: Result) -> Data:
    """Return numbers for the controller; withheld where the verdict does not support them."""
    spec, numbers, why = result.machine.spec, result.numbers, withholding_reason(result.machine)
    effects = result.catalogue
    zeros = any(effects.effect_of(name).controller == "zero" for name in spec.parameters)
    places = [found.members[0] for found in result.located]
    return {
        "drives": numbers.drives if zeros else (),
        "withheld": " ".join(result.cautions) or (sentence(why) if why else ""),
        "rule": RULE,
        "counts": numbers.names.slide_end_words[1][1],
        "standard": spec.controller.sign == (1, 1, 1) and not any(spec.controller.zero),
        # What a calibrated machine does not hold.
        "beyond": listed(one.description for one in places if not one.of_machine),
    }


def reason_not_to_enter(result: Result) -> tuple[str, str]:
    """Return what to do instead of entering numbers, and why, a clause each; empty if they may be
    entered.
    """
    early = "Do not enter these numbers yet"
    if not result.stands:
        return early, "a residual remains that nothing explains, and it would distort them"
    if result.cautions:
        return early, "the verdict warns of what would distort them"
    found = result.firmware.corrections if result.firmware else None
    if found is None or not found.keep:
        return "", ""
    instead = early if result.firmware and result.firmware.again else "Do not enter new numbers"
    return instead, found.keep


def firmware(result: Result) -> Data:
    """Return numbers for a firmware, old and new, and what its model cannot hold."""
    return {"early": reason_not_to_enter(result)}


_AIMS = {
    "separate": "To decide between causes",
    "narrow": "To determine weakly seen values better",
    "trace": "To trace the residual",
}


def next_readings_data(result: Result, sheet: str) -> Data:
    """Return what to measure next, with the sheet as a link."""
    suggested, by_aim = result.next_measurements, dict[str, list[str]]()
    for one in suggested:
        if one.readings:
            by_aim.setdefault(_AIMS[one.aim], []).append(sentence(one.reason))
    data = base64.b64encode(sheet.encode()).decode()
    return {
        "suggestions": by_aim,
        "others": [sentence(s.reason) for s in suggested if s.other_instrument and not s.hopeless],
        "hopeless": [sentence(s.reason) for s in suggested if s.hopeless],
        "link": f"data:text/csv;charset=utf-8;base64,{data}" if sheet else "",
    }


def workspace(result: Result, space: Workspace, figures: Figures) -> Data:
    """Return the TCP's error over the workspace and its uncertainty."""
    every = inline_panels(figures["workspace"])
    rows = [
        ("predicted error without corrections", space.nominal),
        ("predicted error with offsets and lengths corrected", space.before),
        ("95 % radius of that", space.sure_before),
        ("95 % radius with everything found corrected", space.sure),
    ]
    if not result.improved:  # then the base model is all that was found
        del rows[1:3]
    return {
        "rows": [(what, *millimetres([float(v.mean()), float(v.max())])) for what, v in rows],
        "groups": [every[k : k + 3] for k in range(0, len(every), 3)],
    }


def values(result: Result, figures: Figures) -> Data:
    """Return the identified values with their sigmas."""
    fit, of = result.after, result.catalogue.effect_of
    freed = {of(n).name for n in result.identified}
    held = (of(n).name for n, value in result.machine.values.items() if value)
    called = result.catalogue.legs.effect_words
    others = dict.fromkeys(called(name) for name in held if name not in freed)
    return {
        "rows": parameter_rows(result),
        "figure": inline_svg(figures["parameters"]) if "parameters" in figures else "",
        "others": listed(others),
        "dials": any(of(n).of_dial for n in result.identified),
        "scale": f"{fit.sigma_scale:.2g}" if fit.sigma_scale > 1 else "",
    }


def unseen(result: Result) -> Data:
    """Return what the readings cannot distinguish, and what they cannot detect."""
    return {
        "sentences": weak_sentences(result.weak, result.catalogue),
        "effects": undetected_effects(result),
        "unexcited": unvaried_effects(result),
        "sides": sentence(one) if (one := unvaried_words(result)) else "",
        # Not where it is said above that no more readings of a dial on a leg help.
        "second_place": _has_one_place(result)
        and not any(one.hopeless for one in result.next_measurements),
        "owned": ",".join(result.instruments),
        "machine": result.request.machine_option,
    }


def _has_one_place(result: Result) -> bool:
    """Whether some leg was read by dials at a single place along it."""
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
    "machine": "from the machine file, or as is usual of such instruments where it has none",
    "repeats": "from the scatter of the repeats",
}


def method(result: Result) -> Data:
    """Return how the result was computed, from which files, and how to repeat it."""
    setups = result.request.setups
    return {
        "base": base_effects(result),
        "machine": Path(result.request.machine.spec.file).name or "the nominal Orthoglide",
        "mechanism": result.catalogue.legs.in_layout_words(
            "the platform on three pairs of bars, each pair on a carriage"
        ),
        "method": _METHODS[result.before.method],
        "source": _SOURCES[result.noise.source],
        "of_setups": " ".join(_setup_sentences(setups, result.request.machine.spec)),
    }


def _setup_sentences(setups: Sequence[Setup], spec: MachineFile) -> Iterator[str]:
    """Yield what was fitted with every setup, a sentence each."""
    if any(s.observation.from_datum for s in setups):
        placement = compact(spec.dial.placement * 1e3, 2)
        yield (
            f"The dial's zero is free in every setup, and its place along the leg is known to "
            f"{placement} mm."
        )
    if any(s.observation.dials > 1 for s in setups):
        slope = spec.surface_slope
        surface = f"may slope by {compact(slope * 1e3, 2)} mrad" if slope else "is taken as exact"
        yield (
            f"Of two dials on a leg the difference was read, which has no zero of its own; the "
            f"surface that they were set to zero against {surface}."
        )
    if not setups:
        yield "What belongs to a setup is free: a plate's height and slopes, an instrument's frame."
