"""Rival explanations of the same readings: how sure each is, and which are inseparable."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, combinations, pairwise

import numpy as np

from orthoglide.accuracy import workspace
from orthoglide.errors import InputError
from orthoglide.fit import Estimate, Problem, linearise, normal, with_free
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.prediction import Conditions

Values = Mapping[str, float]

_SAME = 0.02  # of the shift between two machines: less is no difference in shape
_GRID = 3


@dataclass(frozen=True)
class Rival:
    """One way to explain the readings at hand."""

    name: str  # of the cause
    values: Values  # parameters of the machine, SI
    parts: tuple[str, ...]  # elementary parameters of the machine that its unknowns set
    weights: Array  # of these for each unknown (E, P)
    covariance: Array  # of the unknowns (P, P), SI, tolerances as priors

    def weights_of(self, names: Sequence[str]) -> Array:
        """Weights of elementary parameters for each unknown ``(n, P)``; 0 where none sets one."""
        matrix = np.zeros((len(names), self.weights.shape[1]))
        matrix[[names.index(part) for part in self.parts]] = self.weights
        return matrix

    def spread(self, names: Sequence[str]) -> Array:
        """Covariance of elementary parameters ``(n, n)``, SI."""
        matrix = self.weights_of(names)
        return np.asarray(matrix @ self.covariance @ matrix.T)


def rival_of(name: str, fit: Estimate | Values, like: Estimate, scale: float) -> Rival:
    """An explanation from its own fit, or from its values.

    Args:
        name: of the cause: a parameter, a structured member, or any other name.
        fit: an estimate of the machine as it is now, or all its parameters, SI.
        like: the fit whose readings, nuisances and base unknowns count where there are values only.
        scale: of the noise, where lack of fit remains.
    """
    if isinstance(fit, Estimate):
        problem, at, nuisance = fit.problem, fit.at, fit.nuisance
    else:
        problem, nuisance = _problem(name, fit, like.problem), like.nuisance
        x = np.array([_value(dict(u.parts[problem.last]), fit) for u in problem.unknowns])
        at = linearise(problem, x)
    here = normal(replace(problem, priors=True), at, nuisance)
    unit = problem.tolerance
    scaled = here.information * unit * unit[:, None] / scale**2
    values = problem.machine.catalogue.of_machine(problem.values(problem.last, at.x))
    covariance = np.linalg.inv(scaled) * unit * unit[:, None]
    return Rival(name, values, *problem.of_machine(problem.last), covariance)


def _problem(name: str, values: Values, like: Problem) -> Problem:
    """The readings at hand with the unknowns of an explanation that is known by its values."""
    if like.prior is not None:  # everything is free, at what was learned of it
        return like
    catalogue = like.machine.catalogue
    setups = tuple(s.name for s in like.setups)
    try:
        own = set(catalogue.elementary(name, setups))
    except InputError:  # a name for people: what has a value is free
        own = set()
    kept = tuple(u for u in like.unknowns if catalogue.effect_of(u.name).name in catalogue.base)
    covered = {p for u in kept for p in u.parts[like.last]} | own
    others = [n for n, v in values.items() if v and n not in covered]
    added = [name, *others] if own else others
    held: tuple[dict[str, float], ...] = tuple({} for _ in like.held)
    return with_free(replace(like, unknowns=kept, held=held), added)


def _value(parts: Mapping[str, float], values: Values) -> float:
    """The unknown that sets its parts to these values, in the least squares."""
    weight = np.array(list(parts.values()))
    given = np.array([values.get(p, 0.0) for p in parts])
    return float(weight @ given / (weight @ weight)) if len(weight) else 0.0


def pairs_within(sizes: Iterable[int]) -> list[tuple[int, int]]:
    """Pairs of rivals of the same set, where sets of these sizes stand one after the other."""
    ends = [0, *accumulate(sizes)]
    return [pair for a, b in pairwise(ends) for pair in combinations(range(a, b), 2)]


# -- rivals that no few readings tell apart --------------------------------------------------------


def inseparable_groups(
    apart: Mapping[tuple[int, int], float],
) -> list[tuple[list[int], float]]:
    """Rivals of which no two can be told apart, and the most sigmas between any two; given are
    those of the pairs that cannot be, the smaller number first.
    """

    def joined(members: set[int]) -> list[float] | None:
        pairs = [(a, b) for a in members for b in members if a < b]
        return [apart[p] for p in pairs] if all(p in apart for p in pairs) else None

    groups: list[set[int]] = []
    for pair in sorted(apart):
        if any(set(pair) <= group for group in groups):
            continue
        for group in groups:
            if joined(group | set(pair)) is not None:
                group |= set(pair)
                break
        else:
            groups.append(set(pair))
    return [(sorted(group), max(joined(group) or [0.0])) for group in groups]


def inseparable_words(
    machine: Machine, rivals: Sequence[Rival], sigmas: float, within_reach: int, level: float
) -> str:
    """Why no reading is proposed for rivals, and what it means for the TCP.

    Args:
        machine: of the workspace.
        rivals: that are inseparable.
        sigmas: the most that was found between two of them.
        within_reach: how many readings they were judged by.
        level: difference of TCPs that does not count, metres.
    """
    conditions = Conditions.at(workspace(machine.geometry, _GRID, machine.spec.screw_pitch))
    points = [machine.model.outputs(e.values, conditions).p for e in rivals]
    apart = [p - q for p in points for q in points]
    shift = max(float(np.linalg.norm(d.mean(axis=0))) for d in apart)
    rest = max(float(np.linalg.norm(d - d.mean(axis=0), axis=1).max()) for d in apart)
    if max(shift, rest) < level:
        tail = "their TCPs are the same, too"
    elif rest < max(_SAME * shift, level):
        tail = f"their TCPs are the same but for a shift of {shift * 1e3:.2g} mm"
    else:
        tail = (
            f"their TCPs differ by up to {rest * 1e3:.2g} mm after the best shift: measure the "
            "TCP, or look at the parts themselves"
        )
    names = [e.name for e in rivals]
    return (
        f"no few readings of a dial on a leg tell {', '.join(names[:-1])} and {names[-1]} apart "
        f"(out of {within_reach} within reach; {sigmas:.1f} sigma at most); {tail}"
    )
