"""What to measure next: where most is left, and what would tell a cause from its rivals."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orthoglide.closing.closed import Closed
    from orthoglide.planning import Suggestion

_MOST_RIVALS = 6  # between which readings are proposed


def next_measurements(closed: Closed) -> tuple[Suggestion, ...]:
    """Readings to take next, what follows something unexplained first."""
    from orthoglide import planning, prospects

    geometry, follow = closed.request.machine.geometry, not closed.stands
    left = closed.lack_of_fit
    again = tuple(map(prospects.repeating, left.by_instrument[:follow]))
    known = closed.posterior
    sets = [one.data for one in closed.effects] + [one.data for one in closed.located]
    data = [each[0] for each in sets if each]
    visits = [prospects.deciding_visits(known, d) for d in data] if known else []
    again = (*again, *(one for one in visits if one is not None))
    parts = [s for one in closed.located if known for s in prospects.parting(known, one)]
    if not geometry.dialled:
        apart = () if known is None else prospects.deciding_instruments(known, closed.effects)
        return (*apart, *parts, *again)
    several = [(c.chosen, *c.rivals) for c in closed.effects if c.rivals]
    several = several or [tuple(closed.alone[:_MOST_RIVALS])]
    rivals = [(e.name, e.machine) for each in several for e in each]
    pairs = planning.pairs_within(map(len, several))
    apart = planning.next_measurements(closed.after, rivals, pairs=pairs, directions=())
    more = planning.next_measurements(closed.before)
    if follow and left.dials_hold_most:
        again = tuple(prospects.tracing(rest, geometry) for rest in left.by_dial[:1])
    return (*again, *apart, *parts, *more)
