"""Unknowns of an identification, and their priors."""

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
from orthoglide.observations import source
from orthoglide.parameters import Parameter, split_campaign

_DRIFT_SHARE = 0.02
"""Share of its tolerance by which a parameter may drift between campaigns without having changed:
the background of other effects that a sound machine is allowed."""

_BOUND_SD = 50.0
"""Tolerances to which a parameter is bounded, so that a solver does not diverge: five standard
deviations of the widest prior of a search, ten tolerances. One on its bound is reported."""

NOTHING_FREE = "nothing is free: name at least one parameter or family to identify"
_MIN_BOUND = {"mm": 0.05, "rad": 0.1}  # SI, by the unit in files: 50 mm and 0.1 rad


@dataclass(frozen=True)
class Unknown:
    """One number to identify."""

    name: Parameter  # as reported; one per campaign is named after the first that it holds for
    # for each factor, the weights of the elementary parameters that it sets
    weights: tuple[Mapping[str, float], ...]
    tolerance: float  # expected standard deviation, SI
    start: float  # SI
    bound: float  # the value stays within plus and minus this, SI
    prior_width: float = 1.0  # standard deviation of its prior, in tolerances


def weight_matrix(names: Sequence[str], weights_by_column: Sequence[Mapping[Any, float]]) -> Array:
    """Return the weights of ``E`` parameters in each of ``P`` columns ``(E, P)``."""
    row_index = {name: k for k, name in enumerate(names)}
    matrix = np.zeros((len(names), len(weights_by_column)))
    for k, weights in enumerate(weights_by_column):
        for name, weight in weights.items():
            matrix[row_index[name], k] = weight
    return matrix


def posterior_rows(
    posterior: Posterior, unknowns: Sequence[Unknown]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return an earlier posterior as whitened rows of ``P`` unknowns: matrix ``(k, P)`` and target
    ``(k,)`` of ``|matrix x - target|^2``, and which of the unknowns it covers ``(P,)``.
    """
    uncertain = [n for n, sigma in posterior.sigmas.items() if sigma > 0]
    is_covered = np.array([u.name in uncertain for u in unknowns], dtype=bool)
    covered = [u.name for u, s in zip(unknowns, is_covered, strict=True) if s]
    matrix = np.zeros((len(covered), len(unknowns)))
    # Parameters that are not free stay at their mean: the covariance is conditioned on them.
    _, block = posterior.regression(covered, [n for n in uncertain if n not in covered])
    tolerance = np.array([u.tolerance for u, s in zip(unknowns, is_covered, strict=True) if s])
    block = block + np.diag((_DRIFT_SHARE * tolerance) ** 2)
    sd = np.sqrt(np.diag(block))
    values, vectors = np.linalg.eigh(block / sd / sd[:, None])
    root = (vectors / np.sqrt(np.maximum(values, 1e-10 * values.max(initial=1.0)))).T / sd
    matrix[:, is_covered] = root
    mean = posterior.mean[[posterior.names.index(name) for name in covered]]
    return matrix, root @ mean, is_covered


def shared_error_rows(
    unknowns: Sequence[Unknown],
    prior_sd: Array,
    shared: Sequence[tuple[Mapping[Any, float], float]],
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the priors of unknowns that share an error beside their own, in the form of
    `posterior_rows`.

    Args:
        unknowns: all ``P``.
        prior_sd: of the error of each alone ``(P,)``, SI.
        shared: weights of the parameters that share an error, each in one set at most, and its
            standard deviation at priors of one tolerance, SI; it widens with these.
    """
    matrix, is_shared = np.diag(1 / prior_sd), np.zeros(len(unknowns), dtype=bool)
    for weights, sd in shared:
        v = np.array([weights.get(u.name, 0.0) * sd / u.tolerance for u in unknowns])
        if square := float(v @ v):  # (1 + v v')^-1/2 is the root of the inverse covariance
            matrix = matrix - np.outer((1 - 1 / np.sqrt(1 + square)) / square * v, v / prior_sd)
            is_shared |= v != 0
    return matrix[is_shared], np.zeros(int(is_shared.sum())), is_shared


def build_unknowns(
    machine: Machine, factors: Sequence[Factor], free: Sequence[str], own: Sequence[str] = ()
) -> tuple[Unknown, ...]:
    """Return the unknowns for effects, parameters or structured members.

    Args:
        machine: gives tolerances and initial values.
        factors: of all campaigns.
        free: names to identify.
        own: effects or parameters with a value for each campaign; ``axis_tilt.y.z@new`` has one
            value before the campaign ``new`` and another from it on.

    Raises:
        InputError: for unknown names, or two campaigns of one name.
    """
    stems = [factor.name for factor in factors]
    if len(set(stems)) != len(stems):
        alike = [source(f.readings) for f in factors if stems.count(f.name) > 1]
        raise InputError(
            f"two campaigns have the same name ({', '.join(alike)}): leave one out if both are one "
            f"file, else rename one (in Python dataclasses.replace(campaign, name='second'))"
        )
    catalogue, unknowns = machine.catalogue, list[Unknown]()
    for name in expand_names(catalogue, free, factors):
        later = range(1, len(stems))
        starts = [0, *(k for k in later if _changes_at(stems[k], name, catalogue, own))]
        for first, end in pairwise([*starts, len(stems)]):
            parts = tuple(
                _parameter_weights(catalogue, name, factor) if first <= k < end else {}
                for k, factor in enumerate(factors)
            )
            if any(parts):
                reported = name.at(stems[first]) if len(starts) > 1 else name
                tolerance = machine.tolerance(reported)
                unit = catalogue.effect_of(reported).unit.name
                bound = max(_BOUND_SD * tolerance, _MIN_BOUND.get(unit, 0.0))
                start = machine.values.get(name, 0.0)
                unknowns.append(Unknown(reported, parts, tolerance, start, bound))
    return tuple(unknowns)


def _changes_at(stem: str, name: Parameter, catalogue: Catalogue, own: Sequence[str]) -> bool:
    """Return whether a parameter has another value from a campaign on than before it."""
    if catalogue[name.effect].of_dial:  # one body, such as a printed part, may be measured again
        return not (catalogue[name.effect].of_body and name.member)
    names = (split_campaign(given) for given in own)
    return any(at in ("", stem) and plain in (name, name.effect) for plain, at in names)


def expand_names(
    catalogue: Catalogue, free: Sequence[str], factors: Sequence[Factor]
) -> tuple[Parameter, ...]:
    """Return the parameters and structured members that names stand for.

    Raises:
        InputError: where these are none.
    """
    setups = tuple(dict.fromkeys(s for factor in factors for s in factor.setup_names))
    parameters = tuple(p.plain for p in catalogue.expand(free, setups))
    if not parameters:
        raise InputError(NOTHING_FREE)
    return tuple(dict.fromkeys(parameters))


def _parameter_weights(
    catalogue: Catalogue, name: Parameter, factor: Factor
) -> Mapping[str, float]:
    effect = catalogue[name.effect]
    if not effect.of_dial:
        return catalogue.elementary_weights(name)
    setups = factor.setups_of(effect)
    if not setups or (name.setup and name.setup not in setups):  # another campaign's setup
        return {}
    return catalogue.elementary_weights(name, setups)


def share_plate_shapes(
    unknowns: Sequence[Unknown], catalogue: Catalogue, separate: Collection[str] = ()
) -> tuple[Unknown, ...]:
    """Return the unknowns with one shape per plate, which all campaigns share; the parameters named
    in ``separate`` stay those of each campaign.
    """
    shared = dict[Parameter, Unknown]()
    for unknown in unknowns:
        plate = catalogue.effect_of(unknown.name).of_body and unknown.name.plain not in separate
        name = unknown.name.plain if plate else unknown.name
        first = shared.setdefault(name, unknown)
        parts = tuple(a or b for a, b in zip(first.weights, unknown.weights, strict=True))
        shared[name] = replace(first, name=name, weights=parts)
    return tuple(shared.values())


def with_bounds(unknowns: Sequence[Unknown], bounds: Mapping[str, float]) -> tuple[Unknown, ...]:
    """Return unknowns with given bounds, each that of its most specific name."""
    names = [(u.name, u.name.plain, u.name.effect) for u in unknowns]
    for key, bound in bounds.items():
        check_choice("free parameter", key, dict.fromkeys(n for forms in names for n in forms))
        if not bound > 0:
            raise InputError(f"the bound of {key} must be a positive number")
    bounded = list[Unknown]()
    for unknown, forms in zip(unknowns, names, strict=True):
        given = [float(bounds[n]) for n in forms if n in bounds]
        bounded.append(replace(unknown, bound=given[0]) if given else unknown)
    return tuple(bounded)
