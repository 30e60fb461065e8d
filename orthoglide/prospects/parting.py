"""Which readings part the places of a class that those at hand cannot: of dials, or at the tool."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from orthoglide.explanation import FullPosterior, Located
from orthoglide.explanation.members import Members
from orthoglide.fit.factors import Factor
from orthoglide.instruments.leg_dial import PLACE
from orthoglide.planning.linear import LinearReadings
from orthoglide.planning.pool import reading_pool
from orthoglide.planning.rivals import Rival
from orthoglide.planning.suggestions import Suggestion, to_separate, usual_load
from orthoglide.prospects.instruments import parting_instruments

_MOST, _COUNT = 6, 12  # places that are parted, the likeliest; readings that may part them


def parting(posterior: FullPosterior, located: Located) -> tuple[Suggestion, ...]:
    """Readings, a dozen at most, that would part the likeliest of a class, and which of them none
    parts.

    Each is a rival with its own free function, which new readings narrow as they do all else.
    """
    members = Members.of(posterior, located, _MOST)
    if len(members.each) < 2:
        return ()
    if not posterior.machine.geometry.dialled:
        return parting_instruments(members)
    found = _by_dials(members)
    if not any(place.of_dial for place in members.places):
        return found
    other = "; take another dial for them than before"
    return tuple(replace(s, reason=s.reason + other) if s.chosen else s for s in found)


def _by_dials(members: Members) -> tuple[Suggestion, ...]:
    posterior = members.posterior
    fit, machine = posterior.after, posterior.machine
    pool = reading_pool(machine.geometry, load=usual_load(fit))
    rows, seen = members.rows(Factor.unread(pool.with_moves(), machine))
    expected = rows @ np.stack([one.mean for one in members.each], axis=1)
    total = fit.problem.noise.typical * max(fit.sigma_scale, 1.0)
    columns = np.hstack([rows, expected])
    readings = LinearReadings.around(machine, pool, columns, seen.by_nuisance[:, PLACE], total)
    names = tuple(str(k) for k in members.at)
    rivals = [
        Rival(f'"{one.words}"', one.machine, names, np.eye(len(names)), one.covariance)
        for one in members.each
    ]
    pairs = [*combinations(range(len(rivals)), 2)]
    apart = [p for p in pairs if any(members.each[k].lasts for k in p)]
    found = to_separate(machine, readings, names, rivals, apart, _COUNT) if apart else []
    gone = [rival.name for rival, one in zip(rivals, members.each, strict=True) if not one.lasts]
    if len(gone) > 1:
        reason = (
            f"no new readings tell {', '.join(gone[:-1])} and {gone[-1]} apart: these belong to "
            f"the session and to the dials that were read; look at the parts themselves"
        )
        found.append(Suggestion(reason, "none", 0.0, pool))
    return tuple(found)
