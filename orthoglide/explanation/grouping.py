"""What could stand out together: the causes of the catalogue, what an owner entered, and places."""

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
"""What ten tolerances lift a sigma above the noise, in all, is weighed: where one drive shows far
more than the others, only these tell whether its error is theirs as well."""

_DIAL_SCALE = 0.3
"""Scale of what stands out of a dial, over that of a part. The widest is three tolerances: a dial
that shows ten per cent too much, or stands ten degrees awry, is seen when it is set up."""


def coefficient_spans(several: Sequence[FreeForm], first: int = 0) -> dict[str, NDArray[np.intp]]:
    """Where the coefficients of each place stand, by its name, behind the ``first`` so many."""
    ends = np.cumsum([first, *(p.kernel.count for p in several)])
    each = zip(several, pairwise(ends), strict=True)
    return {place.name: np.arange(start, end) for place, (start, end) in each}


def _entered_common_causes(wide: Problem, free: int) -> Iterator[tuple[Candidate, float]]:
    """Yield what parts of one set have in common because an owner entered it, unless it is known
    from elsewhere, and how many tolerances of a part are to be expected of it.

    Args:
        wide: with everything free.
        free: so many of its unknowns, the first, belong to the base.
    """
    machine, names = wide.machine, wide.names[:free]
    known = () if wide.earlier_posterior is None else wide.earlier_posterior.names
    for effect, sd in machine.spec.entered.items():
        mine = [n for n in names if n.effect == effect]
        if any(n in known for n in mine):
            continue
        for cause in candidates(mine, [machine.catalogue[effect]], machine.catalogue):
            if cause.name.endswith("common"):
                yield cause, sd / machine.tolerance(effect)


def build_groups(
    wide: Problem,
    free: int,
    columns: Array,
    found: Sequence[FreeForm],
    stands: Mapping[Parameter, tuple[Parameter, float]],
) -> tuple[tuple[Group, ...], tuple[Candidate, ...], tuple[Parameter, ...]]:
    """Causes and places that the readings could show, and the parameters that were asked about.

    A parameter for which another stands has no coefficient: a cause moves that of the other, and
    one that consists of such parameters alone is a name of another cause.
    """
    names, catalogue = [u.name for u in wide.unknowns], wide.machine.catalogue
    excited = {e.name for e in excited_effects(wide)}
    seen = np.linalg.norm(columns, axis=0) > _LEAST_SIGNAL
    asked = [n for n in names[free:] if n.effect in excited]
    index = {n: k for k, n in enumerate(names)}
    # Where campaigns have the other for themselves, no single coefficient stands for it.
    by_other = {n: s for n, s in stands.items() if n in index and s[0] in index}
    own = {n: (n, 1.0) for n in names} | by_other
    visible = [n for n in asked if seen[index[own[n][0]]]]
    effects = [e for e in catalogue.effects if e.name in excited]
    moved = np.array([index[own[n][0]] for n in visible], dtype=np.intp)
    factor = np.array([own[n][1] for n in visible])
    named = np.array([n not in stands for n in visible], dtype=bool)
    causes, groups = [], []
    for cause, unit in _entered_common_causes(wide, free):
        rows = weight_matrix(names, cause.weights)
        at = np.flatnonzero(rows.any(axis=1))
        if np.linalg.norm(columns[:, at] @ rows[at]) * unit > _LEAST_SIGNAL:
            causes.append(cause)
            groups.append(Group(cause.name, at, rows[at], False, cause.relative_prior, unit))
    for cause in candidates(visible, effects, catalogue):
        matrix = weight_matrix(visible, cause.weights)
        if not matrix[named].any():
            continue
        rows = np.zeros((len(names), cause.size))
        np.add.at(rows, moved, matrix * factor[:, None])
        places = np.flatnonzero(rows.any(axis=1))
        causes.append(cause)
        unit = _DIAL_SCALE if catalogue[cause.effect].of_dial else 1.0
        groups.append(Group(cause.name, places, rows[places], False, cause.relative_prior, unit))
    ways = Counter(place.location_key for place in found if not place.is_local)
    for place, (name, own_places) in zip(
        found, coefficient_spans(found, len(names)).items(), strict=True
    ):
        if np.linalg.norm(columns[:, own_places]) > _LEAST_SIGNAL:
            chance = (
                FREE_FORM_PRIOR * place.chance / (1 if place.is_local else ways[place.location_key])
            )
            groups.append(identity_group(name, own_places, free_form=True, relative_prior=chance))
    return tuple(groups), tuple(causes), tuple(asked)
