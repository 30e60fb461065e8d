"""What is identified: the unknowns that names stand for, and what is known of them before."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Catalogue
from orthoglide.errors import InputError, check_choice
from orthoglide.fit.factors import Factor
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.parameters import Parameter, split_campaign

_DRIFT_SHARE = 0.02
"""Share of its tolerance by which a parameter drifts between visits without being a change: as much
as the background of other effects that a machine with nothing wrong is allowed."""

# Beyond these a machine would not be an Orthoglide: they keep a solver from running away, and a
# parameter that ends on one is reported.
_BOUND_SD = 50.0
NOTHING_FREE = "nothing is free: name at least one parameter or family to identify"
_MIN_BOUND = {"mm": 0.05, "rad": 0.1}  # SI, by the unit in files: 50 mm and 0.1 rad


@dataclass(frozen=True)
class Unknown:
    """One number to identify."""

    name: Parameter  # as reported; one per campaign is named after the first that it holds for
    # for each factor, the weights of the elementary parameters that it sets
    weights: tuple[Mapping[str, float], ...]
    tolerance: float  # standard deviation to expect, SI
    start: float  # SI
    bound: float  # the value stays within plus and minus this, SI
    prior_width: float = 1.0  # how many tolerances wide its prior is


def weight_matrix(names: Sequence[str], several: Sequence[Mapping[Any, float]]) -> Array:
    """Weights of parameters in each of several that stand for some of them ``(E, P)``."""
    place = {name: k for k, name in enumerate(names)}
    matrix = np.zeros((len(names), len(several)))
    for k, weights in enumerate(several):
        for name, weight in weights.items():
            matrix[place[name], k] = weight
    return matrix


def posterior_rows(
    known: Posterior, unknowns: Sequence[Unknown]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """What is known of a machine's elementary parameters as whitened rows about ``P`` unknowns.

    Returns:
        Matrix ``(k, P)`` and target ``(k,)`` of ``|matrix x - target|^2``, and which of the
        unknowns these speak of ``(P,)``.
    """
    place = {n: k for k, n in enumerate(known.names) if known.covariance[k, k] > 0}
    spoken = np.array([u.name in place for u in unknowns], dtype=bool)
    chosen = [place[u.name] for u, s in zip(unknowns, spoken, strict=True) if s]
    matrix = np.zeros((len(chosen), len(unknowns)))
    # Parameters that are not free stay at their mean: the covariance is conditioned on them.
    fixed = [k for k in place.values() if k not in set(chosen)]
    block = known.covariance[np.ix_(chosen, chosen)]
    if fixed:
        scale = np.sqrt(np.diag(known.covariance)[fixed])
        among = known.covariance[np.ix_(fixed, fixed)] / scale / scale[:, None]
        across = known.covariance[np.ix_(chosen, fixed)] / scale
        block = block - across @ np.linalg.pinv(among, rcond=1e-9, hermitian=True) @ across.T
    tolerance = np.array([u.tolerance for u, s in zip(unknowns, spoken, strict=True) if s])
    block = block + np.diag((_DRIFT_SHARE * tolerance) ** 2)
    sd = np.sqrt(np.diag(block))
    values, vectors = np.linalg.eigh(block / sd / sd[:, None])
    root = (vectors / np.sqrt(np.maximum(values, 1e-10 * values.max(initial=1.0)))).T / sd
    matrix[:, spoken] = root
    return matrix, root @ known.mean[chosen], spoken


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
            "rename one file, or leave one out if they are identical"
            if all(s.readings.file for s in sources)
            else "give one a name of its own, dataclasses.replace(campaign, name='second'), as "
            "from_frame(..., name='second') does"
        )
        raise InputError(f"two campaigns have the same name ({', '.join(stems)}): {remedy}")
    catalogue, unknowns = machine.catalogue, list[Unknown]()
    for name in expand_names(catalogue, free, sources):
        starts = [0] + [
            k for k in range(1, len(stems)) if _changes_at_campaign(catalogue, name, stems[k], own)
        ]
        for first, end in pairwise([*starts, len(stems)]):
            parts = tuple(
                _parameter_weights(catalogue, name, s) if first <= k < end else {}
                for k, s in enumerate(sources)
            )
            if any(parts):
                shown = name.at(stems[first]) if len(starts) > 1 else name
                tolerance, unit = machine.tolerance(shown), catalogue.effect_of(shown).unit.name
                bound = max(_BOUND_SD * tolerance, _MIN_BOUND.get(unit, 0.0))
                start = machine.values.get(name, 0.0)
                unknowns.append(Unknown(shown, parts, tolerance, start, bound))
    return tuple(unknowns)


def _changes_at_campaign(
    catalogue: Catalogue, name: Parameter, stem: str, own: Sequence[str]
) -> bool:
    """Whether a parameter has another value from a campaign on than before it."""
    if catalogue[name.effect].of_dial:
        one_body = catalogue[name.effect].of_body and name.member  # measured again
        return not one_body
    for chosen in own:
        plain, at = split_campaign(chosen)
        if at in ("", stem) and plain in (name, name.effect):
            return True
    return False


def expand_names(
    catalogue: Catalogue, free: Sequence[str], sources: Sequence[Factor]
) -> tuple[Parameter, ...]:
    """Return the parameters and structured members that names stand for.

    Raises:
        InputError: where these are none.
    """
    setups = tuple(dict.fromkeys(s for source in sources for s in source.setup_names))
    found = tuple(p.plain for p in catalogue.expand(free, setups))
    if not found:
        raise InputError(NOTHING_FREE)
    return tuple(dict.fromkeys(found))


def _parameter_weights(
    catalogue: Catalogue, name: Parameter, source: Factor
) -> Mapping[str, float]:
    effect = catalogue[name.effect]
    if not effect.of_dial:
        return catalogue.elementary_weights(name)
    setups = source.setups_of(effect)
    if not setups or (name.setup and name.setup not in setups):  # another campaign's setup
        return {}
    return catalogue.elementary_weights(name, setups)


def share_plate_shapes(
    unknowns: Sequence[Unknown], catalogue: Catalogue, apart: Collection[str] = ()
) -> tuple[Unknown, ...]:
    """Return the unknowns with one shape per plate, which all campaigns share; plates named in
    ``apart`` keep one for each campaign.
    """
    joined: dict[Parameter, Unknown] = {}
    for unknown in unknowns:
        plate = catalogue.effect_of(unknown.name).of_body and unknown.name.plain not in apart
        name = unknown.name.plain if plate else unknown.name
        one = joined.setdefault(name, replace(unknown, name=name))
        parts = tuple(a or b for a, b in zip(one.weights, unknown.weights, strict=True))
        joined[name] = replace(one, weights=parts)
    return tuple(joined.values())


def with_bounds(unknowns: Sequence[Unknown], bounds: Mapping[str, float]) -> tuple[Unknown, ...]:
    """Unknowns with bounds of their own, each by the nearest of its names that has one."""
    names = [(u.name, u.name.plain, u.name.effect) for u in unknowns]
    for key, bound in bounds.items():
        check_choice("free parameter", key, dict.fromkeys(n for own in names for n in own))
        if not bound > 0:
            raise InputError(f"the bound of {key} must be a positive number")
    nearest = [[float(bounds[n]) for n in own if n in bounds] for own in names]
    each = zip(unknowns, nearest, strict=True)
    return tuple(replace(u, bound=own[0]) if own else u for u, own in each)
