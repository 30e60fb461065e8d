"""What to measure next: where most is left, and what would tell a cause from its rivals."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orthoglide.planning import Suggestion
    from orthoglide.result.result import Result

_MOST_RIVALS = 6  # between which readings are proposed


def next_measurements(result: Result) -> tuple[Suggestion, ...]:
    """Readings to take next, what follows something unexplained first."""
    from orthoglide import planning, prospects

    geometry, follow = result.request.machine.geometry, not result.stands
    again = tuple(map(prospects.repeating, result.rest_of_tool[:follow]))
    known = result.posterior
    parts = [s for one in result.located if known for s in prospects.parting(known, one)]
    if not geometry.dialled:
        apart = () if known is None else prospects.deciding_instruments(known, result.effects)
        return (*apart, *parts, *again)
    sets = [(c.chosen, *c.rivals) for c in result.effects if c.rivals]
    sets = sets or [tuple(result.alone[:_MOST_RIVALS])]
    rivals = [(e.name, e.machine) for each in sets for e in each]
    pairs = planning.pairs_within(map(len, sets))
    apart = planning.next_measurements(result.after, rivals, pairs=pairs, directions=())
    more = planning.next_measurements(result.before)
    if result.dials_hold_most:
        again = tuple(prospects.tracing(rest, geometry) for rest in result.rest[:follow])
    return (*again, *apart, *parts, *more)
