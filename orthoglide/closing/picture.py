"""What pictures of a result show: the machine, its dials, and every explanation on the part."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from orthoglide.effects.words import toward
from orthoglide.explanation import Curve
from orthoglide.explanation.change import Change
from orthoglide.geometry import LEGS
from orthoglide.machine import Machine
from orthoglide.numerals import compact
from orthoglide.pictures import dials, joint_mark, option
from orthoglide.result import Picture
from orthoglide.scene import Mark, Option

if TYPE_CHECKING:
    from orthoglide.closing.outcome import RunOutcome


def picture(closed: RunOutcome) -> Picture:
    """Return the drawing of the machine with what was found, or with the dial of the largest
    residual.
    """
    machine = closed.request.machine.with_only({})
    posed = machine.posed()
    stand = dials(posed, closed.after.problem.campaigns)
    options: list[Option] = []
    first = []
    for cause in closed.effects:
        first.append(len(options))
        options += [option(machine, one.words, one.values) for one in cause.explanations]
        options += [_located_option(machine, curve) for curve in cause.places]
    for found in closed.located:
        first.append(len(options))
        options += [_located_option(machine, curve) for curve in found.members]
    for change in closed.moved:
        first.append(len(options))
        options += _change_options(machine, change)
    of_dials = closed.lack_of_fit.dials_hold_most
    if closed.word == "unexplained" and of_dials and closed.request.searches:
        first.append(len(options))
        options.append(_residual_option(closed))
    return Picture(posed, stand, tuple(options), tuple(first))


def _change_options(machine: Machine, change: Change) -> list[Option]:
    """Return what may have changed, each on its part, with direction and size."""
    options = []
    for words, (name, by) in zip(
        change.member_clauses, change.change_by_member.items(), strict=True
    ):
        made = option(machine, words, {name: by} if math.isfinite(by) else {})
        marks = (replace(m, label=m.label and f"changed by {m.label}") for m in made.marks)
        options.append(replace(made, marks=tuple(marks)))
    return options


def _located_option(machine: Machine, curve: Curve) -> Option:
    """Return the mark of a located error: the joint that moves, by the curve that was found."""
    place, size = curve.place, curve.size_words
    if place.of_dial:
        return Option(place.words, (Mark("dial", -1, np.zeros(3), size, setup=place.setup),))
    if place.moves_bar_ends:
        way = np.eye(3)[LEGS.index(place.direction)]
        return Option(place.words, (Mark("platform", place.leg, way, size, both=True),))
    both, along = place.loses, place.against == "travel"
    bars = len(place.joints) > 1
    value = curve.value - curve.value.mean() if along else np.full(len(curve.at), curve.size)
    travel = curve.at if along else np.linspace(*machine.geometry.stroke, len(curve.at))
    joint = place.joints[0][0]
    return Option(
        place.words, (joint_mark(machine, place.leg, joint, travel, value, size, both, bars),)
    )


def _residual_option(closed: RunOutcome) -> Option:
    most = closed.lack_of_fit.by_dial[0]
    way = np.eye(3)[most.axis] * np.sign(most.most)
    size = f"{compact(abs(most.most) * 1e3, 2)} mm toward {toward(LEGS[most.axis], most.most)}"
    words = f"the residual is largest on leg {LEGS[most.leg]}: {size}"
    return Option(words, (Mark("dial", most.leg, way, size, setup=most.setup),))
