"""The formula of each kind of reading, as CasADi functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca

from orthoglide.effects import Catalogue, Effect
from orthoglide.instruments import POSE_SIZE, Observation, ReadingVariables
from orthoglide.mechanism.rows import RowFunction


class Formula:
    """The formula of a kind of reading, as CasADi functions of rows.

    Args:
        observation: the kind of reading.
        effects: effects of its instrument, with ``D`` parameters for a setup.
        numbers: count ``M`` of the numbers that describe a mounting.

    Attributes:
        function: (pose ``(12,)``, other pose ``(12,)``, mounting ``(M,)``, nuisances ``(K,)``,
            effects ``(max(D, 1),)``) -> reading.
        value: :attr:`function` for rows.
        tangent: readings and their derivatives by pose, other pose, nuisances and effects.
    """

    def __init__(self, observation: Observation, effects: Sequence[Effect], numbers: int) -> None:
        count = sum(len(e.parameters(("",))) for e in effects)
        sizes = (POSE_SIZE, POSE_SIZE, numbers, observation.nuisance_count, max(count, 1))
        symbols = [ca.SX.sym(name, n) for name, n in zip("pomzv", sizes, strict=True)]
        pose, other, mounting, nuisance, values = (ca.vertsplit(s) for s in symbols)
        row = ReadingVariables(pose, other, mounting, nuisance, values[:count])
        reading = ca.SX(observation.formula(row, effects))
        self.function = ca.Function(observation.kind, symbols, [reading])
        by = [ca.densify(ca.gradient(reading, symbols[k])) for k in (0, 1, 3, 4)]
        self.value = RowFunction(self.function)
        self.tangent = RowFunction(
            ca.Function(f"{observation.kind}_tangent", symbols, [reading, *by])
        )


@dataclass
class Formulas:
    """Formulas of all kinds for one catalogue, built when they are needed."""

    catalogue: Catalogue
    _formulas: dict[tuple[str, int], Formula] = field(default_factory=dict)

    def effects(self, observation: Observation) -> tuple[Effect, ...]:
        """Return the effects of a kind's instrument, in the order of its formula."""
        return tuple(e for e in self.catalogue.instrument_effects if observation.is_affected_by(e))

    def parameter_names(self, observation: Observation, setup: str) -> tuple[str, ...]:
        """Return the names of the ``D`` parameters of a setup's instrument."""
        return tuple(str(n) for e in self.effects(observation) for n in e.parameters((setup,)))

    def formula(self, observation: Observation, numbers: int) -> Formula:
        """Return the formula of a kind for mountings that ``numbers`` numbers describe."""
        key = observation.kind, numbers
        if key not in self._formulas:
            self._formulas[key] = Formula(observation, self.effects(observation), numbers)
        return self._formulas[key]
