"""What to read next, and when the verdict is settled.

It begins with both dials at a quarter of each leg in turn, up and down the stroke; where that
shows nothing, near their carriages too, as small causes take more readings. After that every sheet
holds the readings that tell most between the explanations that are in play: causes that were named
with their rivals, and causes that may stand out and do not yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.closing import Closed
from orthoglide.errors import OrthoglideError
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.observations.protocols import check_dials, dial_at, unread
from orthoglide.planning import next_measurements, next_sheet
from orthoglide.planning.pool import dial_scale

SETTLED = (
    "The verdict is settled when nothing significant is left, no cause that may stand out is open "
    "(between 5 % and 90 %), and no two dozen further readings would part the causes named by two "
    "standard deviations; that nothing is wrong is believed after 90 readings."
)
"""The criterion, in words."""

MOST = 126
"""Readings after which the answer is what it is: half of a sweep sheet."""

_INNER = (0.57, 0.43, 0.71, 0.34, 0.64)
"""Places between zero and the ends of the stroke, as parts of its halves, sheet by sheet: none on
the same phase of a screw as zero and the ends, as round numbers often are."""

_DIALS = ((0.25, 0), (0.65, 0), (0.25, 1), (0.65, 2), (0.5, 0))
"""Where the dials stand, as parts of the leg, and the bar they touch (0: the median line): first,
and where more is to be seen. The first two together find every effect from a fifth more than the
size at which a sweep sheet does, or less (``orthoglide.prospects.smallest_effects``)."""

_CLEARANCE = 8e-3
"""Metres that a dial keeps from the ends of its leg, over the whole stroke; on a machine of less
than a workshop's size in proportion."""

_BELIEVED = 90  # readings after which it is believed that nothing is wrong
_OPEN = (0.05, 0.9)  # probability of a cause that may stand out or not
_MOST_OPEN = 3
_COUNT = 24  # readings at a time
_TELLS = 2.0  # sigmas between two explanations that readings are worth
_SHEETS = 6


@dataclass(frozen=True)
class Next:
    """What to do after a closed."""

    reason: str  # a sentence
    sheet: Readings | None = None  # to read; `None` where no further reading is worth it
    settled: bool = False  # whether the verdict is


def opening(machine: Machine, number: int = 0) -> Readings:
    """The sheet to begin with: both dials on each leg in turn, up, down and back, both ways at all
    places but the ends; later numbers with other places.

    Raises:
        InputError: for a machine against whose legs no dial is set.
    """
    geometry = machine.geometry
    check_dials(geometry)
    share, bar = _DIALS[number % len(_DIALS)]
    low, high = geometry.stroke
    clearance = _CLEARANCE * dial_scale(geometry)
    ends = (high + clearance) / geometry.L, 1 + (low - clearance) / geometry.L
    share = round(float(np.clip(share, *ends)), 3)
    part = _INNER[number % len(_INNER)]
    travels = [part * high, high, part * high, 0.0, part * low, low, part * low, 0.0]
    pairs = [(leg, axis) for leg in range(3) for axis in range(3) if axis != leg]
    setups = tuple(dial_at(geometry, leg, axis, share, bar) for leg, axis in pairs)
    visits = [(leg, travel, dial) for leg in range(3) for travel in travels for dial in range(2)]
    command = [geometry.command_on_axis(leg, travel) for leg, travel, _ in visits]
    return unread(
        geometry,
        "measure",
        setups,
        [2 * leg + dial for leg, _, dial in visits],
        np.round(command, 9),
        posture=[f"{travel * 1e3:+.6g}" for _, travel, _ in visits],
    ).with_moves()


def following(closed: Closed, number: int, room: int) -> Next:
    """What to do after so many sheets, where there is room for so many readings more."""
    machine, taken = closed.request.machine, sum(map(len, closed.request.campaigns))
    left = closed.word in ("partial", "unexplained")
    rivals = _in_play(closed)
    count = max(min(_COUNT, room), 2)
    found = next_measurements(closed.after, rivals, count=count, directions=())
    chosen = next_sheet([s for s in found if s.aim == "separate" and s.gain >= _TELLS])
    more = opening(machine, number)
    if left:
        reason, sheet = "something is left", _renamed(more, number)
    elif chosen is not None:
        reason, sheet = (
            "in play are " + ", ".join(name for name, _ in rivals),
            _renamed(chosen, number),
        )
    elif not closed.found and taken < _BELIEVED:
        reason, sheet = "nothing was found yet", _renamed(more, number)
    else:
        return Next("nothing more in reach would tell more", settled=True)
    if len(sheet) > room or number >= _SHEETS:
        return Next(f"{reason}, and no more readings were to be taken")
    return Next(reason, sheet)


def _in_play(closed: Closed) -> list[tuple[str, Estimate]]:
    """Explanations between which further readings are to decide, each with its fit."""
    base = closed.before.names
    chosen = [e.chosen.parameters for e in closed.effects]
    found: list[tuple[str, Sequence[str]]] = []
    for k, cause in enumerate(closed.effects):
        others = [n for j, own in enumerate(chosen) if j != k for n in own]
        if cause.rivals:
            several = (cause.chosen, *cause.rivals)
            found += [(e.name, (*others, *e.parameters)) for e in several]
    named = [n for own in chosen for n in own]
    low, high = _OPEN
    stands = {name for e in closed.effects for name in (e.name, *e.indistinguishable_from)}
    doubtful = [c for c in closed.candidates if c.parameters and low < c.probability < high]
    doubtful = [c for c in doubtful if c.name not in stands]
    if doubtful and not found:
        found.append((" and ".join(e.name for e in closed.effects) or "nothing", named))
    found += [(c.name, (*named, *c.parameters)) for c in doubtful[:_MOST_OPEN]]
    return [(n, fit) for n, parts in found if (fit := _fitted(closed, (*base, *parts)))]


def _fitted(closed: Closed, names: Sequence[str]) -> Estimate | None:
    """The readings by one explanation; ``None`` where they cannot be fitted by it."""
    try:
        return identify(
            closed.before.problem.campaigns, closed.request.machine, tuple(dict.fromkeys(names))
        )
    except OrthoglideError:
        return None


def _renamed(sheet: Readings, number: int) -> Readings:
    """Every mounting of a sheet with a name that no earlier one has."""
    named = (replace(s, name=f"{s.name.removeprefix('next-')}-{number + 1}") for s in sheet.setups)
    return replace(sheet, setups=tuple(named))
