"""Which readings part the places of a class that those at hand cannot: of dials, or at the tool."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from orthoglide.explanation import FullPosterior, Located
from orthoglide.explanation.members import Members
from orthoglide.fit.factors import Factor
from orthoglide.instruments import AT_TOOL
from orthoglide.instruments.leg_dial import PLACE
from orthoglide.observations import Readings
from orthoglide.ordering import ranked
from orthoglide.planning.criteria import RivalSeparation
from orthoglide.planning.linear import LinearReadings
from orthoglide.planning.pool import reading_pool
from orthoglide.planning.rivals import Rival
from orthoglide.planning.sheets import sheets_of
from orthoglide.planning.suggestions import DECIDES, Pairs, Suggestion, to_separate, usual_load

_MOST, _COUNT = 6, 12  # places that are parted, the likeliest; readings that may part them
_AT_TOOL = tuple(kind for kind, one in AT_TOOL.items() if not one.touches)
"""A plate may have any shape, which a free function of any part draws as well."""


def parting(posterior: FullPosterior, located: Located) -> tuple[Suggestion, ...]:
    """Readings, a dozen at most, that would part the likeliest of a class, and which of them none
    parts.

    Each is a rival with its own free function, which new readings narrow as they do all else.
    """
    members = Members.of(posterior, located, _MOST)
    if len(members.each) < 2:
        return ()
    if not posterior.machine.geometry.dialled:
        return tuple(_at_tool(members))
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


# -- instruments at the tool -----------------------------------------------------------------------


def _at_tool(members: Members) -> Iterator[Suggestion]:
    """A sentence for each that parts any two, that which most probably does first; else one that
    none does.
    """
    sheets = sheets_of(members.posterior.after.problem.machine, _AT_TOOL)
    every = {k: _apart(members, s) for k, s in sheets.items() if s.of_tool}
    chance = [one.probability for one in members.each]

    def worth(kind: str) -> float:
        return sum(chance[a] * chance[b] for (a, b), s in every[kind].items() if s >= DECIDES)

    def said(pair: tuple[int, int], sigmas: float) -> str:
        one, other = (members.each[k].words for k in pair)
        return f'"{one}" from "{other}" by {sigmas:.1f} sigma'

    for kind in ranked(filter(worth, every), worth):
        told = {pair: s for pair, s in every[kind].items() if s >= DECIDES}
        more = f" (and {len(told) - 1} further pairs)" if told.keys() - {min(told)} else ""
        yield Suggestion(
            f"to tell the places apart measure with {AT_TOOL[kind].words}: expected to "
            f"separate {said(min(told), told[min(told)])}{more}; a sheet for it: orthoglide design "
            f"--owns {kind} --machine machine.toml --out {kind}.csv",
            "none", max(told.values()), None,
        )  # fmt: skip
    best: Pairs = {pair: max(of[pair] for of in every.values()) for pair in every[_AT_TOOL[0]]}
    never = {pair: sigmas for pair, sigmas in best.items() if sigmas < DECIDES}
    if never:
        pair = min(never)
        yield Suggestion(
            f"no instrument at the tool separates {said(pair, never[pair])} or more", "none",
            never[pair], None,
        )  # fmt: skip


def _apart(members: Members, sheet: Readings) -> Pairs:
    """Sigmas between each two by an instrument's own sheet."""
    machine = members.posterior.after.problem.machine
    factor = Factor.unread(sheet, machine)
    sigma = factor.sigma
    rows, seen = members.rows(factor)
    of_setup = factor.nuisances(seen)
    columns = np.hstack([rows, rows @ np.stack([one.mean for one in members.each], axis=1)])
    columns, own = columns / sigma[:, None], of_setup.columns / sigma[:, None]
    across = own.T @ columns
    among = own.T @ own + np.diag(of_setup.sd**-2.0)
    information = columns.T @ columns - across.T @ np.linalg.solve(among, across)
    spread = np.stack([one.covariance for one in members.each])
    pairs = np.array([*combinations(range(len(members.each)), 2)])
    return replace(RivalSeparation.between(spread, pairs), information=information).sigmas
