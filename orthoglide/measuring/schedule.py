"""What to read next, and when the verdict is settled.

Measuring begins with both dials near the platform of each leg in turn; where nothing is found, near
the carriages too, as small causes take more readings. After that every sheet contains the readings
that the verdict itself suggests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orthoglide.closing import RunOutcome
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.observations.protocols import (
    labelled_postures,
    leg_dial_campaign,
    require_dial_layout,
)
from orthoglide.planning import next_sheet
from orthoglide.planning.pool import dial_scale
from orthoglide.planning.suggestions import DECISIVE_SIGMAS

SETTLED_CRITERION = (
    "The verdict is settled when no significant lack of fit is left and no suggested readings "
    "would separate two explanations by two standard deviations; that nothing is wrong is believed "
    "after 90 readings."
)
"""The criterion, in words."""

MAX_READINGS = 126
"""Readings after which the answer is what it is: half of a sweep sheet."""

_INNER_STATIONS = (0.57, 0.43, 0.71, 0.34, 0.64)
"""Stations between zero and the ends of the stroke, as parts of its halves, sheet by sheet: none on
the same phase of a screw as zero and the ends, as round numbers often are."""

_DIAL_PLACES = ((0.25, 0), (0.65, 0), (0.25, 1), (0.65, 2), (0.5, 0))
"""Where the dials stand, as parts of the leg, and the bar that they touch (0: the median line),
sheet by sheet. The first two together find every effect from a fifth more than the size at which a
sweep sheet does, or less (``orthoglide.smallest_effects``)."""

_CLEARANCE = 8e-3
"""Metres that a dial keeps from the ends of its leg, over the whole stroke, times `dial_scale`."""

_MIN_READINGS_NOTHING_WRONG = 90  # readings after which it is believed that nothing is wrong
_MAX_SHEETS = 6  # after so many nobody goes on


@dataclass(frozen=True)
class NextStep:
    """What to do after a verdict."""

    reason: str  # a clause
    sheet: Readings | None = None  # to read; `None` where no further reading is worth it
    settled: bool = False  # whether the verdict is


def opening_sheet(machine: Machine, number: int = 0) -> Readings:
    """Return the sheet to begin with: both dials on each leg in turn, up, down and back, both ways
    at all stations but the ends; later numbers have other places.

    Raises:
        InputError: for a machine against whose legs no dial is set.
    """
    geometry = machine.geometry
    require_dial_layout(geometry)
    share, bar = _DIAL_PLACES[number % len(_DIAL_PLACES)]
    low, high = geometry.stroke
    clearance = _CLEARANCE * dial_scale(geometry)
    ends = (high + clearance) / geometry.L, 1 + (low - clearance) / geometry.L
    share = round(float(np.clip(share, *ends)), 3)
    inner = _INNER_STATIONS[number % len(_INNER_STATIONS)]
    travels = [inner * high, high, inner * high, 0.0, inner * low, low, inner * low, 0.0]
    return leg_dial_campaign(geometry, "measure", [(share,)], labelled_postures(travels), bar=bar)


def next_step(outcome: RunOutcome, number: int, readings_left: int) -> NextStep:
    """Return what to do after so many sheets, where there is room for so many readings more."""
    taken = sum(map(len, outcome.request.campaigns))
    suggested = [
        s for s in outcome.next_measurements
        if s.aim == "trace" or (s.aim == "separate" and s.gain >= DECISIVE_SIGMAS)
    ]  # fmt: skip
    sheet = next_sheet(suggested)
    if sheet is not None:
        reason = suggested[0].reason.partition(":")[0]
    elif not outcome.found and taken < _MIN_READINGS_NOTHING_WRONG:
        reason, sheet = "nothing was found yet", opening_sheet(outcome.request.machine, number)
    else:
        return NextStep("no further readings within reach would tell more", settled=outcome.stands)
    if len(sheet) > readings_left or number >= _MAX_SHEETS:
        return NextStep(f"{reason}, and no more readings were to be taken")
    return NextStep(reason, _with_new_names(sheet, number))


def _with_new_names(sheet: Readings, number: int) -> Readings:
    """Return the sheet with names of its mountings that no earlier sheet has."""
    named = (replace(s, name=f"{s.name.removeprefix('next-')}-{number + 1}") for s in sheet.setups)
    return replace(sheet, setups=tuple(named))
