"""The drawing of the machine with the findings of a run marked on it."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import accumulate, chain

import numpy as np

from orthoglide.closing.outcome import RunOutcome
from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.words import toward
from orthoglide.explanation.change import Change
from orthoglide.geometry import LEGS
from orthoglide.machine import Machine
from orthoglide.numerals import compact
from orthoglide.pictures import dials, joint_mark, option
from orthoglide.result import Curve
from orthoglide.result.display import Picture
from orthoglide.scene import Mark, Option


def picture(outcome: RunOutcome) -> Picture:
    """Return the drawing of the machine with the findings marked, or with the dial of the largest
    residual.
    """
    machine = outcome.before.problem.machine.with_only({})
    posed = machine.posed()
    groups: list[list[Option]] = []  # one for each finding, most probable option first
    for cause in outcome.effects:
        causes = [option(machine, e.words, e.values) for e in cause.explanations]
        groups.append([*causes, *(_located_option(machine, c) for c in cause.places)])
    groups += [[_located_option(machine, c) for c in f.members] for f in outcome.located]
    groups += [_change_options(machine, change) for change in outcome.moved]
    dials_hold_most = outcome.lack_of_fit.dials_hold_most
    if outcome.word == "unexplained" and dials_hold_most and outcome.request.searches:
        groups.append([_residual_option(outcome)])
    first_shown = accumulate([len(group) for group in groups[:-1]], initial=0) if groups else ()
    mounted_dials = dials(posed, outcome.after.problem.campaigns)
    return Picture(posed, mounted_dials, tuple(chain(*groups)), tuple(first_shown))


def _change_options(machine: Machine, change: Change) -> list[Option]:
    """Return the parameters that may have changed, each marked on its part."""
    options = []
    members = zip(change.member_clauses, change.change_by_member.items(), strict=True)
    for words, (name, difference) in members:
        drawn = option(machine, words, {name: difference} if math.isfinite(difference) else {})
        marks = (replace(m, label=m.label and f"changed by {m.label}") for m in drawn.marks)
        options.append(replace(drawn, marks=tuple(marks)))
    return options


def _located_option(machine: Machine, curve: Curve) -> Option:
    """Return a located error, marked by its curve at the joint that it moves."""
    place: FreeForm = curve.place
    size = curve.size_words
    if place.of_dial:
        return Option(place.words, (Mark("dial", -1, np.zeros(3), size, setup=place.setup),))
    if place.moves_bar_ends:
        direction = np.eye(3)[LEGS.index(place.direction)]
        return Option(place.words, (Mark("platform", place.leg, direction, size, both=True),))
    # A curve without a sign runs to both sides of its line.
    both, along = curve.loses or not place.is_signed, place.against == "travel"
    bars = len(place.joints) > 1
    value = curve.value if along else np.full(len(curve.at), curve.size)
    travel = curve.at if along else np.linspace(*machine.geometry.stroke, len(curve.at))
    joint = place.joints[0][0]
    mark = joint_mark(machine, place.leg, joint, travel, value, size, both, bars)
    return Option(place.words, (mark,))


def _residual_option(outcome: RunOutcome) -> Option:
    """Return the largest residual, marked at its dial."""
    largest = outcome.lack_of_fit.by_dial[0]
    direction = np.eye(3)[largest.axis] * np.sign(largest.most)
    way = toward(LEGS[largest.axis], largest.most)
    size = f"{compact(abs(largest.most) * 1e3, 2)} mm toward {way}"
    words = f"the residual is largest on leg {LEGS[largest.leg]}: {size}"
    return Option(words, (Mark("dial", largest.leg, direction, size, setup=largest.setup),))
