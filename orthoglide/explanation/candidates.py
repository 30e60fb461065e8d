"""Candidate causes, the groups of coefficients that may be active, and signatures for planning.

With a candidate's signature S at its tolerance (whitened, projected) and the residual r, the
Gaussian prior of the tolerance gives the candidate's gain and evidence:

    gain     = r^T S (S^T S + 1)^-1 S^T r              (reduction of chi2, prior included)
    evidence = (gain - log det(S^T S + 1)) / 2         (log Bayes factor against no effect)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Catalogue, Effect
from orthoglide.effects.free_form import FreeForm
from orthoglide.explanation.gains import explained_by_group
from orthoglide.explanation.linear_model import (
    FREE_FORM_PRIOR,
    Group,
    identity_group,
    left_singular,
    shrink_along,
)
from orthoglide.fit import Estimate, Problem, with_effects_freed
from orthoglide.fit.assembling import excited_effects
from orthoglide.fit.least_squares import fitted_basis, linearise, whiten_and_project
from orthoglide.fit.unknowns import weight_matrix
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter


@dataclass(frozen=True)
class Candidate:
    """A cause that may be added to the model."""

    name: Parameter  # as `axis_tilt.y.z`, `axis_tilt.cyclic`, `axis_tilt` or `screw_error.x`
    effect: str  # name of its effect
    parameters: tuple[Parameter, ...]  # that it frees, as `with_free` takes them
    weights: tuple[Mapping[str, float], ...]  # of elementary unknowns, for each of `parameters`

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def relative_prior(self) -> float:
        """Prior probability, relative to a cause of one part.

        A pattern over n parts has 1/n, as each of them would have to be wrong. A common error has
        1, as parts of one drawing and one supplier share their errors.
        """
        if self.size > 1 or self.parameters[0].plain.endswith("common"):
            return 1.0
        return 1.0 / len(self.weights[0])


def candidates(
    names: Sequence[Parameter], effects: Sequence[Effect], catalogue: Catalogue
) -> tuple[Candidate, ...]:
    """Return all candidates made of elementary unknowns: single, structured, and whole effects."""
    by_weights: dict[str, Candidate] = {}
    for effect in effects:
        effect_names = [n for n in names if n.effect == effect.name]
        list_parts = _plate_candidates if effect.of_body else _part_candidates
        parts = tuple(list_parts(effect, effect_names, catalogue))
        pairs = _pair_candidates(parts) if effect.paired else ()
        for candidate in (*parts, *pairs, *_family_candidates(effect, effect_names)):
            # Equal weights under two names would be one cause twice.
            weights_key = (sorted((str(n), w) for n, w in c.items()) for c in candidate.weights)
            by_weights.setdefault(repr(sorted(weights_key)), candidate)
    return tuple(by_weights.values())


def _plate_candidates(
    effect: Effect, names: list[Parameter], catalogue: Catalogue
) -> list[Candidate]:
    """Return the shapes of one plate, which all setups and campaigns share."""
    if len(set(names)) == len({n.direction for n in names}):
        return [Candidate(n, effect.name, (n,), ({n: 1.0},)) for n in names]
    shared = catalogue.structured_members(effect.name, tuple({n.setup for n in names}))
    weights_of: dict[Parameter, dict[str, float]]
    weights_of = {m: {n: 1.0 for n in names if n.plain in w} for m, w in shared.items()}
    return [Candidate(m, effect.name, (m,), (w,)) for m, w in weights_of.items() if w]


def _part_candidates(
    effect: Effect, names: list[Parameter], catalogue: Catalogue
) -> Iterator[Candidate]:
    """Yield the parts that an effect may concern: single ones, and patterns of several.

    Parameters of the machine that are specific to campaigns make one cause together. Those of dials
    do not, because each campaign has other dials.
    """
    blocks: dict[str, dict[Parameter, tuple[str, ...]]] = {}  # campaigns by plain name
    for name in names:
        block = blocks.setdefault(name.campaign if effect.of_dial else "", {})
        block[name.plain] = (*block.get(name.plain, ()), name.campaign)
    for block in blocks.values():
        patterns = catalogue.structured_members(effect.name, [n.setup for n in block])
        for member, weights in (*((n, {n: 1.0}) for n in block), *patterns.items()):
            campaign_sets = {block.get(n, ()) for n in weights}
            if len(campaign_sets) == 1 and all(campaign_sets):
                (campaigns,) = campaign_sets
                parameters = tuple(member.at(c) for c in campaigns)
                copies: tuple[dict[str, float], ...]
                copies = tuple({n.at(c): w for n, w in weights.items()} for c in campaigns)
                cause = parameters[0] if effect.of_dial else member
                yield Candidate(cause, effect.name, parameters, copies)


def _pair_candidates(parts: Sequence[Candidate]) -> Iterator[Candidate]:
    """Yield the pairs of a paired effect: parts that differ in their direction alone."""
    pairs: dict[Parameter, list[Candidate]] = {}
    for part in parts:
        pairs.setdefault(part.name.undirected, []).append(part)
    for name, pair in pairs.items():
        parameters, weights = (
            tuple(each for part in pair for each in getattr(part, what))
            for what in ("parameters", "weights")
        )
        yield Candidate(name, pair[0].effect, parameters, weights)


def _family_candidates(effect: Effect, names: list[Parameter]) -> list[Candidate]:
    """Return a whole effect, if its patterns do not represent it."""
    if effect.of_dial or len(names) < 2:
        return []
    # If all legs have the same directions, the common patterns represent the whole effect.
    has_patterns = len({n.direction for n in names}) > 1 and effect.names.same_directions
    if has_patterns:
        return []
    whole = Parameter(effect.name)
    return [Candidate(whole, effect.name, tuple(names), tuple({m: 1.0} for m in names))]


_LEAST_SIGNAL = 0.1
"""Least signature of one tolerance, in sigmas over all readings. It is small because readings may
see one drive far better than the others, whose errors still decide whether all are off alike."""

_DIAL_SCALE = 0.3
"""Slab scale of dials, relative to parts of the machine. The largest slab is then three tolerances:
a dial that reads ten per cent too much, or is ten degrees askew, is noticed at setup."""


def coefficient_spans(errors: Sequence[FreeForm], first: int = 0) -> dict[str, NDArray[np.intp]]:
    """Return the coefficient indices of each free-form error by name, counted from ``first``."""
    ends = np.cumsum([first, *(error.kernel.count for error in errors)])
    spans = zip(errors, pairwise(ends), strict=True)
    return {error.name: np.arange(start, end) for error, (start, end) in spans}


def _common_base_causes(
    full_problem: Problem, base_count: int
) -> Iterator[tuple[Candidate, float]]:
    """Yield the error that all parts share, for each effect of the base but the zeros, with the
    size to expect in tolerances of a part: the one that an owner entered, or 1. All rods may be cut
    to one wrong length, for example.

    Causes that an earlier calibration determined are left out.

    Args:
        full_problem: with all parameters free.
        base_count: number of its first unknowns, which belong to the base.
    """
    machine, names = full_problem.machine, full_problem.names[:base_count]
    earlier = full_problem.earlier_posterior
    prior_names = () if earlier is None else earlier.names
    sizes = {e: machine.tolerance(e) for e in dict.fromkeys(n.effect for n in names)
             if machine.catalogue[e].controller != "zero"}  # fmt: skip
    for effect, sd in (sizes | machine.spec.entered).items():
        effect_names = [n for n in names if n.effect == effect]
        if any(n in prior_names for n in effect_names):
            continue
        for cause in candidates(effect_names, [machine.catalogue[effect]], machine.catalogue):
            if cause.name.endswith("common"):
                yield cause, sd / machine.tolerance(effect)


def build_groups(
    full_problem: Problem,
    base_count: int,
    columns: Array,
    free_form_errors: Sequence[FreeForm],
    replacements: Mapping[Parameter, tuple[Parameter, float]],
) -> tuple[tuple[Group, ...], tuple[Parameter, ...]]:
    """Return the visible groups and the excited parameters.

    A replaced parameter has no coefficient: a cause moves that of its replacement. A cause that
    consists of replaced parameters only is another name of a cause and is left out.
    """
    names, catalogue = [u.name for u in full_problem.unknowns], full_problem.machine.catalogue
    excited = {e.name for e in excited_effects(full_problem)}
    visible_columns = np.linalg.norm(columns, axis=0) > _LEAST_SIGNAL
    varied = [n for n in names[base_count:] if n.effect in excited]
    index = {n: k for k, n in enumerate(names)}
    # A replacement that is specific to campaigns has no single coefficient.
    available = {n: s for n, s in replacements.items() if n in index and s[0] in index}
    target = {n: (n, 1.0) for n in names} | available
    visible = [n for n in varied if visible_columns[index[target[n][0]]]]
    effects = [e for e in catalogue.effects if e.name in excited]
    target_index = np.array([index[target[n][0]] for n in visible], dtype=np.intp)
    factor = np.array([target[n][1] for n in visible])
    is_named = np.array([n not in replacements for n in visible], dtype=bool)
    groups = []
    for cause, unit in _common_base_causes(full_problem, base_count):
        rows = weight_matrix(names, cause.weights)
        moved = np.flatnonzero(rows.any(axis=1))
        if np.linalg.norm(columns[:, moved] @ rows[moved]) * unit > _LEAST_SIGNAL:
            groups.append(_cause_group(cause, rows, unit))
    for cause in candidates(visible, effects, catalogue):
        matrix = weight_matrix(visible, cause.weights)
        if not matrix[is_named].any():
            continue
        rows = np.zeros((len(names), cause.size))
        np.add.at(rows, target_index, matrix * factor[:, None])
        effect = catalogue[cause.effect]
        unit = _DIAL_SCALE if effect.of_dial and not effect.of_body else 1.0
        groups.append(_cause_group(cause, rows, unit))
    form_counts = Counter(e.location_key for e in free_form_errors if not e.is_variant)
    spans = coefficient_spans(free_form_errors, len(names))
    for error, (name, span) in zip(free_form_errors, spans.items(), strict=True):
        if np.linalg.norm(columns[:, span]) > _LEAST_SIGNAL:
            forms = 1 if error.is_variant else form_counts[error.location_key]
            prior = FREE_FORM_PRIOR * error.chance / forms
            group = identity_group(name, span, free_form=True, relative_prior=prior, source=error)
            groups.append(group)
    return tuple(groups), tuple(varied)


def _cause_group(cause: Candidate, rows: Array, unit: float) -> Group:
    """Return a cause as a group, from the weights of all coefficients ``(C, size)``."""
    moved, prior = np.flatnonzero(rows.any(axis=1)), cause.relative_prior
    return Group(cause.name, moved, rows[moved], False, prior, unit, source=cause)


BACKGROUND = 0.02
"""Size of every effect on a sound machine, in tolerances."""

_LEAST_VISIBLE = 0.3  # sigmas over all readings: least visible signature of one tolerance


@dataclass(frozen=True)
class Signatures:
    """Signatures of all effects in the readings.

    All vectors are whitened by the noise. Datums, placements and all parameters of the fit, with
    their priors, are projected out. Rows are the augmented readings ``(m,)``.
    """

    names: tuple[str, ...]  # elementary unknowns beyond the fit (E,)
    tolerance: Array  # of these (E,), SI
    columns: Array  # signatures (m, E), per SI unit
    candidates: tuple[Candidate, ...]  # all that are made of these unknowns
    invisible: tuple[Parameter, ...]  # unknowns that these readings cannot show

    @property
    def weighted_by_background(self) -> Signatures:
        """The signatures whitened by the noise and ``BACKGROUND`` tolerances of every effect
        together, whose covariance is ``1 + U diag(s^2) U^T``: the readings of a sound machine are
        then of standard normal distribution.
        """
        left, singular = left_singular(self.columns * (BACKGROUND * self.tolerance))
        weighted = shrink_along(self.columns, left, 1 - 1 / np.sqrt(1 + singular**2))
        return replace(self, columns=weighted)

    def signature(self, candidate: Candidate) -> Array:
        """Return the signature of a candidate at its tolerance ``(m, size)``."""
        return self.columns @ self.weights_at_tolerance(candidate)

    def weights_at_tolerance(self, candidate: Candidate) -> Array:
        """Return elementary unknowns for one tolerance of each parameter of a candidate ``(E,
        size)``.
        """
        matrix = weight_matrix(self.names, candidate.weights)
        size = np.array([self.tolerance[np.flatnonzero(column)].max() for column in matrix.T])
        return np.asarray(matrix * size)

    def evidences(self, residuals: Array) -> Array:
        """Return the log Bayes factor of each candidate against no effect ``(C, k)``, for residuals
        ``(m, k)``.
        """
        evidences, chi2 = [], np.sum(residuals**2, axis=0)
        for candidate in self.candidates:
            columns = self.signature(candidate)
            gram, products = columns.T @ columns, residuals.T @ columns
            explained, occam = explained_by_group(gram, products, chi2, [1.0])
            evidences.append((explained / 2 - occam)[..., 0])
        return np.stack(evidences)


def signatures(estimate: Estimate) -> Signatures:
    """Linearise all effects of the catalogue at a fit, with its unknowns and nuisances projected
    out.

    There are none if all effects are free already, as after a calibration.
    """
    problem, nuisance = estimate.problem, estimate.nuisance
    effects = excited_effects(problem)
    full_problem = with_effects_freed(problem, [e.name for e in effects])
    base_count = len(problem.unknowns)
    at = linearise(full_problem, full_problem.zero_padded(estimate.x))
    basis = fitted_basis(problem, nuisance, estimate.at)
    columns = whiten_and_project(nuisance.weighing, basis, at.jacobian[:, base_count:])
    tolerance = np.array([u.tolerance for u in full_problem.unknowns[base_count:]])
    names = tuple(u.name for u in full_problem.unknowns[base_count:])
    visible_mask = np.linalg.norm(columns, axis=0) * tolerance > _LEAST_VISIBLE
    kept = np.flatnonzero(visible_mask)
    visible = tuple(names[k] for k in kept)
    return Signatures(
        visible,
        tolerance[kept],
        columns[:, kept],
        candidates(visible, effects, problem.machine.catalogue),
        tuple(n for n, is_visible in zip(names, visible_mask, strict=True) if not is_visible),
    )
