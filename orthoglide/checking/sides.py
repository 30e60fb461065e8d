"""The readings of two states of a machine, as one problem and each for itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.result import Request


def of_all(
    machine: Machine,
    before: Sequence[Readings],
    after: Sequence[Readings],
    noise: float | None,
    seed: int,
) -> tuple[Request, bool]:
    """The request of both states, and whether it lacks readings of the old one: a fit has the dials
    first and takes the tool's readings for those of the last state.
    """
    dials = tuple(r for r in (*before, *after) if not r.of_tool)
    tool = [r for r in (*before, *after) if r.of_tool]
    past = [r for r in before if r in tool and any(d in after for d in dials)]
    points = tuple(r for r in tool if r not in past)
    request = Request("close-loop", dials, machine, (), noise, seed, points=points)
    return request, bool(past)


def of_one(request: Request, side: Sequence[Readings]) -> Request:
    """The request of one state alone."""
    dials = tuple(r for r in side if not r.of_tool)
    return replace(request, campaigns=dials, points=tuple(r for r in side if r.of_tool))


def told_apart(
    old: Sequence[Readings], new: Sequence[Readings]
) -> tuple[list[Readings], list[Readings]]:
    """The campaigns of both sides, no two of one name; an instrument at the tool that is the only
    one of its kind at both visits has one name at both.
    """
    now, then = (_only_ones(side) for side in (new, old))
    called = {name: now[kind] for kind, name in then.items() if kind in now}

    def renamed(one: Readings) -> Readings:
        if not one.of_tool:
            return one
        names = [called.get(s.name, s.name) for s in one.setups]
        if len(set(names)) < len(names):
            return one
        setups = zip(one.setups, names, strict=True)
        return replace(one, setups=tuple(replace(s, name=name) for s, name in setups))

    old = [renamed(one) for one in old]
    # What both visits read comes first in the new one: there the files of a visit begin anew.
    known = {name for one in old for name in _at_tool(one)}
    new = sorted(new, key=lambda one: known.isdisjoint(_at_tool(one)))
    names = [c.name for c in (*old, *new)]
    if len(set(names)) == len(names):
        return list(old), list(new)
    sides = ((old, "old"), (new, "new"))
    before, after = (
        [replace(c, name=f"{side}-{k}-{c.name}") for k, c in enumerate(several, start=1)]
        for several, side in sides
    )
    return before, after


def _at_tool(one: Readings) -> list[str]:
    """Names of the setups at the tool, none of dials on legs."""
    return [s.name for s in one.setups] if one.of_tool else []


def _only_ones(side: Sequence[Readings]) -> dict[str, str]:
    """Names of setups at the tool by their kind, where there is one of it."""
    named = {(s.kind, s.name) for c in side if c.of_tool for s in c.setups}
    count = Counter(kind for kind, _ in named)
    return {kind: name for kind, name in named if count[kind] == 1}
