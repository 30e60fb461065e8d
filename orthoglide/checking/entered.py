"""How the zeros that earlier readings ask for were entered, by what changed since."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from orthoglide.accuracy import best_zeros
from orthoglide.checking.difference import CHANGED, Difference
from orthoglide.machine import Machine

_NEAR = 0.05  # of what was asked for: people enter two digits
_CLEAR = 3.0  # times that what was asked for must be, for the ways to look different
_ASKED = "as much as the readings before ask for"
_WAYS = {
    1.0: f"{_ASKED}: {{}} entered",
    2.0: f"twice {_ASKED}: {{}} entered twice, or added to what had been entered before",
    -1.0: (
        f"{_ASKED}, but the other way: {{}} entered with the other sign. If that is how the "
        f"controller counts, enter new zeros with the other sign too; if it was a slip, as told"
    ),
}


def entered(was: Machine, differences: Iterable[Difference]) -> Iterator[str]:
    """A clause for each way in which drives' zeros changed as they should have, or should not.

    Args:
        was: the machine as the old state's readings have it.
        differences: of both states.
    """
    advised, drives = best_zeros(was), dict[float, list[str]]()
    for one in differences:
        told = -advised.get(str(one.parameter), 0.0)
        near = max(CHANGED * one.sigma, _NEAR * abs(told))
        if not one.changed or abs(told) < _CLEAR * near:
            continue
        for times in _WAYS:
            if abs(one.after - one.before - times * told) < near:
                drives.setdefault(times, []).append(one.parameter.leg)
    for times, legs in drives.items():
        first, *others = legs
        which = f"zeros of drives {', '.join(legs)}" if others else f"zero of drive {first}"
        yield f"the {which} changed by {_WAYS[times].format('they were' if others else 'it was')}"
