"""Groups that may be active: causes of the catalogue, entered common causes, free-form errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects.free_form import FreeForm
from orthoglide.explanation.candidates import Candidate, candidates
from orthoglide.explanation.linear_model import FREE_FORM_PRIOR, Group, identity_group
from orthoglide.fit import Problem
from orthoglide.fit.excitation import excited_effects
from orthoglide.fit.unknowns import weight_matrix
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter

_LEAST_SIGNAL = 0.1
"""Least signature of one tolerance, in sigmas over all readings. It is small because readings may
see one drive far better than the others, whose errors still decide whether all are off alike."""

_DIAL_SCALE = 0.3
"""Slab scale of dials, relative to parts of the machine. The largest slab is then three tolerances:
a dial that reads ten per cent too much, or is ten degrees askew, is noticed at setup."""


def coefficient_spans(errors: Sequence[FreeForm], first: int = 0) -> dict[str, NDArray[np.intp]]:
    """Return the coefficient indices of each free-form error by name, counted from ``first``."""
    ends = np.cumsum([first, *(p.kernel.count for p in errors)])
    spans = zip(errors, pairwise(ends), strict=True)
    return {error.name: np.arange(start, end) for error, (start, end) in spans}


def _entered_common_causes(
    full_problem: Problem, base_count: int
) -> Iterator[tuple[Candidate, float]]:
    """Yield the common causes whose size an owner entered, with that size in tolerances of a part.

    Causes that an earlier calibration determined are left out.

    Args:
        full_problem: with all parameters free.
        base_count: number of its first unknowns, which belong to the base.
    """
    machine, names = full_problem.machine, full_problem.names[:base_count]
    earlier = full_problem.earlier_posterior
    prior_names = () if earlier is None else earlier.names
    for effect, sd in machine.spec.entered.items():
        own_names = [n for n in names if n.effect == effect]
        if any(n in prior_names for n in own_names):
            continue
        for cause in candidates(own_names, [machine.catalogue[effect]], machine.catalogue):
            if cause.name.endswith("common"):
                yield cause, sd / machine.tolerance(effect)


def build_groups(
    full_problem: Problem,
    base_count: int,
    columns: Array,
    free_form_errors: Sequence[FreeForm],
    replacements: Mapping[Parameter, tuple[Parameter, float]],
) -> tuple[tuple[Group, ...], tuple[Candidate, ...], tuple[Parameter, ...]]:
    """Return the visible groups, their causes, and the parameters that the commands excite.

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
    causes, groups = [], []
    for cause, unit in _entered_common_causes(full_problem, base_count):
        rows = weight_matrix(names, cause.weights)
        moved = np.flatnonzero(rows.any(axis=1))
        if np.linalg.norm(columns[:, moved] @ rows[moved]) * unit > _LEAST_SIGNAL:
            causes.append(cause)
            groups.append(Group(cause.name, moved, rows[moved], False, cause.relative_prior, unit))
    for cause in candidates(visible, effects, catalogue):
        matrix = weight_matrix(visible, cause.weights)
        if not matrix[is_named].any():
            continue
        rows = np.zeros((len(names), cause.size))
        np.add.at(rows, target_index, matrix * factor[:, None])
        moved = np.flatnonzero(rows.any(axis=1))
        causes.append(cause)
        unit = _DIAL_SCALE if catalogue[cause.effect].of_dial else 1.0
        groups.append(Group(cause.name, moved, rows[moved], False, cause.relative_prior, unit))
    form_counts = Counter(error.location_key for error in free_form_errors if not error.is_local)
    spans = coefficient_spans(free_form_errors, len(names))
    for error, (name, span) in zip(free_form_errors, spans.items(), strict=True):
        if np.linalg.norm(columns[:, span]) > _LEAST_SIGNAL:
            forms = 1 if error.is_local else form_counts[error.location_key]
            prior = FREE_FORM_PRIOR * error.chance / forms
            groups.append(identity_group(name, span, free_form=True, relative_prior=prior))
    return tuple(groups), tuple(causes), tuple(varied)
