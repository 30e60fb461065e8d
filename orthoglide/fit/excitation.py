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


def _column_varies(column: str) -> Callable[[Problem], bool]:
    """Return a test whether finite values of a column differ in any table."""

    def vary(problem: Problem) -> bool:
        for factor in problem.factors:
            values = getattr(factor.readings, column, None)
            if values is None:
                continue
            known = values[np.isfinite(values).reshape(len(values), -1).all(axis=1)]
            if len(known) and np.ptp(known, axis=0).max() > 0:
                return True
        return False

    return vary


_CONDITION_TESTS: Mapping[str, Callable[[Problem], bool]] = {
    "approach": lambda problem: any(
        axes_approached_from_both_sides(f.conditions().approach).any() for f in problem.factors
    ),
    "time": _column_varies("time"),
    "temperature": _column_varies("temperature"),
    "load": lambda problem: any(f.conditions().load.any() for f in problem.factors),
    "pitch": lambda problem: problem.machine.spec.screw_pitch is not None,
}
