"""What the legs' bars and links do wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from orthoglide.effects.effect import Family, LegConditions, Motion, once
from orthoglide.units import MM, Unit


def _constant(value: float) -> Callable[[LegConditions], Any]:
    return lambda _: value


def _both_bars(basis: Callable[[LegConditions], Any]) -> tuple[Motion, Motion]:
    return Motion("stretch1", basis), Motion("stretch2", basis)


LEG_LENGTH = Family(
    "leg_length",
    MM,
    0.05,
    because="bars are matched on one fixture, to a few hundredths",
    sentence="both bars of the leg are longer or shorter than nominal",
    look_at="the bars' length between their pivots, with a height gauge",
    members=once(*_both_bars(_constant(1.0))),
)

BAR_MISMATCH = Family(
    "bar_mismatch",
    MM,
    0.05,
    because="bars of a pair are drilled together, to a few hundredths",
    sentence="the two bars of the leg differ: the platform turns as it travels",
    look_at="the two bars side by side, and the play of their pivots",
    members=once(Motion("stretch1", _constant(0.5)), Motion("stretch2", _constant(-0.5))),
)

PARALLELOGRAM_WIDTH = Family(
    "parallelogram_width",
    MM,
    0.1,
    because="short links are turned and drilled, to a tenth at most",
    sentence="the short link at the platform is wider or narrower than the one at the carriage",
    look_at="the distance of the bars at both ends, with a calliper",
    members=once(Motion("width1", _constant(0.5)), Motion("width2", _constant(0.5))),
)

THERMAL_GROWTH = Family(
    "thermal_growth",
    Unit("1/K", 1.0),
    5e-6,
    because="half of what steel or aluminium grows beyond a machine that grows as a whole",
    sentence="the leg's bars grow with temperature, more than the frame",
    look_at="what warms the leg: a motor nearby, sun, the spindle's air",
    members=once(*_both_bars(lambda c: c.length * c.warming)),
    group="temperature",
)

THERMAL_DRIFT = Family(
    "thermal_drift",
    Unit("1/s", 1.0),
    1e-8,
    because="a degree an hour on steel is 3e-9 a second",
    sentence="the leg's bars grow as time goes on",
    look_at="whether the machine was warm when the readings began",
    members=once(*_both_bars(lambda c: c.length * c.time)),
    group="temperature",
)

FAMILIES = (LEG_LENGTH, BAR_MISMATCH, PARALLELOGRAM_WIDTH, THERMAL_GROWTH, THERMAL_DRIFT)
