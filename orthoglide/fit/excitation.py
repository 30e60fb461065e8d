"""Effects that readings could show: those whose conditions they vary."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.fit.problem import Problem
from orthoglide.geometry import Array


def excited_effects(problem: Problem) -> tuple[Effect, ...]:
    """Return the effects beyond the base whose conditions the readings vary."""
    catalogue = problem.machine.catalogue
    return tuple(
        effect
        for effect in catalogue.effects
        if effect.name not in catalogue.base
        and not unmet_conditions(problem, effect)
        and not (effect.instead_of and _CONDITION_TESTS[effect.instead_of](problem))
        and (not effect.of_dial or any(f.setups_of(effect) for f in problem.factors))
    )


def unmet_conditions(problem: Problem, effect: Effect) -> tuple[str, ...]:
    """Return the conditions that an effect needs and the readings do not vary."""
    return tuple(sorted(need for need in effect.needs if not _CONDITION_TESTS[need](problem)))


def axes_approached_from_both_sides(approach: Array) -> NDArray[np.bool_]:
    """Return which axes ``(3,)`` readings ``(n, 3)`` approach from both sides, as booleans."""
    return np.asarray((approach > 0).any(axis=0) & (approach < 0).any(axis=0))


def _varies(problem: Problem, column: str) -> bool:
    """Return whether the finite values of a column differ in any table."""
    columns = [getattr(factor.readings, column) for factor in problem.factors]
    return any(len(np.unique(values[np.isfinite(values)])) > 1 for values in columns)


_CONDITION_TESTS: Mapping[str, Callable[[Problem], bool]] = {
    "approach": lambda problem: any(
        axes_approached_from_both_sides(f.conditions().approach).any() for f in problem.factors
    ),
    "time": lambda problem: _varies(problem, "time"),
    "temperature": lambda problem: _varies(problem, "temperature"),
    "load": lambda problem: any(f.conditions().load.any() for f in problem.factors),
    "pitch": lambda problem: problem.machine.spec.screw_pitch is not None,
}
