"""Errors of the legs' bars and links."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from orthoglide.effects.effect import Constant, Effect, LegConditions, Motion, once
from orthoglide.effects.words import Words
from orthoglide.units import MM, Unit


def _both_bars(basis: Callable[[LegConditions], Any]) -> tuple[Motion, Motion]:
    return Motion("stretch1", basis), Motion("stretch2", basis)


LEG_LENGTH = Effect(
    "leg_length",
    MM,
    0.05,
    because="bars are matched on one fixture, to a few hundredths",
    sentence="both bars of the leg are longer or shorter than nominal",
    look_at="the bars' length between their pivots, with a height gauge or a long calliper",
    members=once(*_both_bars(Constant(1.0))),
    words=Words(
        "the bars of leg {leg} are {size} {longer|shorter} than nominal",
        "the bars of leg {leg} are not of nominal length",
        "the bars of the legs are not of nominal length",
        confirm="measure the bars of leg {leg} between their pivots: expect {size} {more|less} "
        "than nominal on the average of the two",
        common="the bars of all legs are {size} {longer|shorter} than nominal",
    ),
    controller="bar_length",
    urdf=True,
)

BAR_MISMATCH = Effect(
    "bar_mismatch",
    MM,
    0.05,
    because="bars of a pair are drilled together, to a few hundredths",
    sentence="the two bars of the leg differ: the platform turns as it travels",
    look_at="the two bars side by side, and the play of their pivots",
    members=once(Motion("stretch1", Constant(0.5)), Motion("stretch2", Constant(-0.5))),
    words=Words(
        "bar 1 of leg {leg} is {size} {longer|shorter} than bar 2",
        "the two bars of leg {leg} differ in length",
        "the two bars of each leg differ in length",
        confirm="measure both bars of leg {leg} between their pivots: expect bar 1 {size} "
        "{longer|shorter} than bar 2",
        common="bar 1 of every leg is {size} {longer|shorter} than bar 2",
    ),
)

PARALLELOGRAM_WIDTH = Effect(
    "parallelogram_width",
    MM,
    0.1,
    because="short links are turned and drilled, to a tenth at most",
    sentence="the short link at the platform is wider or narrower than the one at the carriage",
    look_at="the distance of the bars at both ends, with a calliper",
    members=once(Motion("width1", Constant(0.5)), Motion("width2", Constant(0.5))),
    words=Words(
        "the short link of leg {leg} at the platform is {size} {wider|narrower} than the one at "
        "the carriage",
        "the two short links of leg {leg} differ",
        "the short links at the platform differ from those at the carriages",
        confirm="measure the distance of the bars of leg {leg} at both ends: expect it {size} "
        "{wider|narrower} at the platform",
        common="the short links of all legs at the platform are {size} {wider|narrower} than those "
        "at the carriages",
    ),
)

THERMAL_GROWTH = Effect(
    "thermal_growth",
    Unit("1/K", 1.0),
    5e-6,
    because="half of what steel grows, as the difference between bars and frame",
    sentence="the leg's bars grow with temperature, more than the frame",
    look_at="what warms the leg: a motor nearby, sun, the spindle's air",
    members=once(*_both_bars(lambda c: c.length * c.warming)),
    words=Words(
        "the bars of leg {leg} {grow|shrink} by {size}",
        "the bars of leg {leg} grow with temperature",
        "the bars grow with temperature",
        "{µm} a metre and kelvin",
        "measure the bars of leg {leg} cold and 10 K warmer: expect them {µm:10} a metre "
        "{longer|shorter}",
        common="the bars of all legs {grow|shrink} by {size}",
    ),
    group="temperature",
)

THERMAL_DRIFT = Effect(
    "thermal_drift",
    Unit("1/s", 1.0),
    1e-8,
    because="steel that warms by three degrees an hour grows by 1e-8 a second",
    sentence="the leg's bars grow as time goes on",
    look_at="whether the machine was warm when the readings began",
    members=once(*_both_bars(lambda c: c.length * c.time)),
    words=Words(
        "the bars of leg {leg} {grow|shrink} by {size}",
        "the bars of leg {leg} grow as time goes on",
        "the bars grow as time goes on",
        "{µm:3600} a metre and hour",
        "measure the bars of leg {leg} at the start and an hour later: expect them {µm:3600} a "
        "metre {longer|shorter}",
        common="the bars of all legs {grow|shrink} by {size}",
    ),
    group="temperature",
    instead_of="temperature",
)

EFFECTS = (LEG_LENGTH, BAR_MISMATCH, PARALLELOGRAM_WIDTH, THERMAL_GROWTH, THERMAL_DRIFT)
