"""From names to unknowns, and from unknowns to a problem; the one way to free more."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

from orthoglide.effects import Catalogue
from orthoglide.errors import InputError, check_word
from orthoglide.fit.factors import Factor
from orthoglide.fit.noise import Noise
from orthoglide.fit.problem import Problem
from orthoglide.fit.unknown import Unknown
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.parameters import Parameter, plain_and_campaign

# Beyond these a machine would not be an Orthoglide: they keep a solver from running away, and a
# parameter that ends on one is reported.
_BOUND_SD = 50.0
_NOTHING = "nothing is free: name at least one parameter or family to identify"
_LEAST_BOUND = {"mm": 0.05, "rad": 0.1}


def build_unknowns(
    machine: Machine, sources: Sequence[Factor], free: Sequence[str], own: Sequence[str] = ()
) -> tuple[Unknown, ...]:
    """Unknowns for effects, parameters or structured members.

    Args:
        machine: tolerances, and where to start.
        sources: what is own to a campaign is repeated for each.
        free: what to identify.
        own: effects or parameters that each campaign has for itself; ``axis_tilt.y.z@new`` has
            one value before the campaign ``new`` and another from it on.

    Raises:
        InputError: for names that are none, or campaigns of one name.
    """
    stems = [s.name for s in sources]
    if len(set(stems)) != len(stems):
        remedy = (
            "rename one file, or leave one out where it is the same"
            if all(s.readings.file for s in sources)
            else "give one a name of its own, dataclasses.replace(campaign, name='second'), as "
            "from_frame(..., name='second') does"
        )
        raise InputError(f"two campaigns are called alike ({', '.join(stems)}): {remedy}")
    catalogue, unknowns = machine.catalogue, list[Unknown]()
    for name in _expanded(catalogue, free, sources):
        starts = [0] + [k for k in range(1, len(stems)) if _begins(catalogue, name, stems[k], own)]
        for first, end in pairwise([*starts, len(stems)]):
            parts = tuple(
                _parts(catalogue, name, s) if first <= k < end else {}
                for k, s in enumerate(sources)
            )
            if any(parts):
                shown = name.at(stems[first]) if len(starts) > 1 else name
                tolerance, unit = machine.tolerance(shown), catalogue.effect_of(shown).unit.name
                bound = max(_BOUND_SD * tolerance, _LEAST_BOUND.get(unit, 0.0))
                start = machine.values.get(name, 0.0)
                unknowns.append(Unknown(shown, parts, tolerance, start, bound))
    return tuple(unknowns)


def _begins(catalogue: Catalogue, name: Parameter, stem: str, own: Sequence[str]) -> bool:
    """Whether a parameter has another value from a campaign on than before it."""
    if catalogue[name.effect].of_dial:
        one_body = catalogue[name.effect].of_body and name.member  # measured again
        return not one_body
    for chosen in own:
        plain, at = plain_and_campaign(chosen)
        if at in ("", stem) and plain in (name, name.effect):
            return True
    return False


def _expanded(
    catalogue: Catalogue, free: Sequence[str], sources: Sequence[Factor]
) -> tuple[Parameter, ...]:
    setups = tuple(dict.fromkeys(s for source in sources for s in source.setup_names))
    found = tuple(p.plain for p in catalogue.expand(free, setups))
    if not found:
        raise InputError(_NOTHING)
    return tuple(dict.fromkeys(found))


def _parts(catalogue: Catalogue, name: Parameter, source: Factor) -> Mapping[str, float]:
    effect = catalogue[name.effect]
    if not effect.of_dial:
        return catalogue.elementary(name)
    setups = source.setups_of(effect)
    if not setups or (name.setup and name.setup not in setups):  # another campaign's setup
        return {}
    return catalogue.elementary(name, setups)


def build_problem(
    machine: Machine,
    factors: Sequence[Factor],
    free: Sequence[str],
    noise: Noise,
    *,
    own: Sequence[str] = (),
    priors: bool = True,
    bounds: Mapping[str, float] | None = None,
    earlier: Posterior | None = None,
) -> Problem:
    """Put an identification together; arguments as of :func:`identify`, but readings with their
    noise, those of legs first, that noise in one figure, and what an earlier calibration says. What
    is own to each campaign need not be free.

    Raises:
        InputError: where these do not fit together.
    """
    if not factors:
        raise InputError("there is no campaign: give at least one file of readings")
    nothing = Problem(machine, tuple(factors), (), noise, priors, (), tuple(own), earlier)
    stems = [s.name for s in nothing.factors]
    for name in own:
        plain, stem = plain_and_campaign(name)
        if stem and stem not in stems:
            raise InputError(f"{name}: there is no campaign {stem!r}, only {', '.join(stems)}")
        _expanded(machine.catalogue, [plain], nothing.factors)
    unknowns = build_unknowns(machine, nothing.factors, free, own)
    if not unknowns:  # all of instruments that none of these readings are of
        raise InputError(_NOTHING)
    if bounds:
        unknowns = _bounded(unknowns, bounds)
    every = tuple(machine.values for _ in nothing.factors)
    return replace(nothing, unknowns=unknowns, held=_without(every, unknowns))


def _without(
    held: Sequence[Mapping[str, float]], unknowns: Sequence[Unknown]
) -> tuple[dict[str, float], ...]:
    """Return the values of each factor that no unknown sets, which stay held."""
    free = [{n for u in unknowns for n in u.parts[k]} for k in range(len(held))]
    return tuple(
        {n: v for n, v in values.items() if n not in set_here}
        for values, set_here in zip(held, free, strict=True)
    )


def with_free(problem: Problem, names: Sequence[str], *, release: bool = True) -> Problem:
    """The same problem with more freed; what is free already is not freed twice.

    Args:
        problem: to be extended.
        names: effects, parameters or structured members; with ``@`` only that campaign's.
        release: whether values that were held are let go; else the unknowns are changes of them.

    Returns:
        The problem with the new unknowns behind those that it has.
    """
    present = set(problem.names)
    added: list[Unknown] = []
    for name in names:
        plain, stem = plain_and_campaign(name)
        for unknown in build_unknowns(problem.machine, problem.factors, [plain], problem.own):
            wanted = not stem or unknown.name.campaign in ("", stem)
            if wanted and unknown.name not in present:
                present.add(unknown.name)
                added.append(unknown)
    # With more freed, whether a value is beyond its tolerance is asked anew.
    unknowns = (*problem.at_tolerance().unknowns, *added)
    held = _without(problem.held, unknowns) if release else problem.held
    return replace(problem, unknowns=unknowns, held=held)


def with_others(problem: Problem, effects: Sequence[str]) -> Problem:
    """The same problem with all single parameters of effects that no unknown sets yet: changes of
    what is held.
    """
    taken = {p for u in problem.unknowns for parts in u.parts for p in parts}
    found: dict[Parameter, None] = {}
    for unknown in build_unknowns(problem.machine, problem.factors, list(effects)):
        if not any(p in taken for parts in unknown.parts for p in parts):
            found[unknown.name.plain] = None
    return with_free(problem, tuple(found), release=False)


def one_plate(
    unknowns: Sequence[Unknown], catalogue: Catalogue, apart: Collection[str] = ()
) -> tuple[Unknown, ...]:
    """The same with one shape for each plate, whichever campaign it was probed in, unless it is
    named among those that changed.
    """
    joined: dict[Parameter, Unknown] = {}
    for unknown in unknowns:
        plate = catalogue.effect_of(unknown.name).of_body and unknown.name.plain not in apart
        name = unknown.name.plain if plate else unknown.name
        one = joined.setdefault(name, replace(unknown, name=name))
        parts = tuple(a or b for a, b in zip(one.parts, unknown.parts, strict=True))
        joined[name] = replace(one, parts=parts)
    return tuple(joined.values())


def _bounded(unknowns: Sequence[Unknown], bounds: Mapping[str, float]) -> tuple[Unknown, ...]:
    """Unknowns with bounds of their own, each by the nearest of its names that has one."""
    names = [(u.name, u.name.plain, u.name.effect) for u in unknowns]
    for key, bound in bounds.items():
        check_word("free parameter", key, dict.fromkeys(n for own in names for n in own))
        if not bound > 0:
            raise InputError(f"the bound of {key} must be a positive number")
    nearest = [[float(bounds[n]) for n in own if n in bounds] for own in names]
    each = zip(unknowns, nearest, strict=True)
    return tuple(replace(u, bound=own[0]) if own else u for u, own in each)
