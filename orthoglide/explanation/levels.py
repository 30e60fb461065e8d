"""A level that counts the other way, is read about the other axis, or shows degrees.

Zeros and lengths turn no platform: the base fits such readings as well as any, and causes that turn
it are found for them. Only the weighing of everything tells that those of others would do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.errors import InputError, NumericsError
from orthoglide.explanation.faults import REQUIRED_EVIDENCE
from orthoglide.explanation.full_posterior import FullPosterior, full_posterior
from orthoglide.explanation.signatures import signatures
from orthoglide.fit import Estimate
from orthoglide.fit.solving import solve
from orthoglide.observations import Readings, source
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of

_PRIOR_WIDTH = 5.0  # tolerances
_DEGREE = np.pi / 180 / 1e-3  # a reading in degrees that was taken for milliradians


@dataclass(frozen=True)
class _LevelInterpretation:
    """What readings of a level may mean instead."""

    signs: tuple[float, float] = (1.0, 1.0)  # by which those about x and about y are multiplied
    exchanged: bool = False  # whether those about x are about y
    factor: float = 1.0  # of all of them
    clause: str = ""  # how they fit, and what to do

    def applied_to(self, points: Readings) -> Readings:
        """The same readings with that meaning."""
        level = points.angular
        sign = np.where(level, np.take(self.signs, points.axis % 2), 1.0) * points.sign
        axis = np.where(level & self.exchanged, 1 - points.axis, points.axis)
        reading = np.where(level, self.factor, 1.0) * points.reading
        return replace(points, sign=sign, axis=axis, reading=reading)


_LEVEL_INTERPRETATIONS = (
    _LevelInterpretation((-1, -1), clause="with the opposite sign: look which way it counts, right-handed about "
                          "x and y, and put -x and -y as directions"),
    _LevelInterpretation((-1, 1), clause="with the opposite sign about x: look which way it counts there, and put "
                         "-x as direction"),
    _LevelInterpretation((1, -1), clause="with the opposite sign about y: look which way it counts there, and put "
                         "-y as direction"),
    _LevelInterpretation(exchanged=True, clause="with x and y exchanged: correct the directions"),
    _LevelInterpretation(factor=_DEGREE, clause="as degrees: put them into milliradians, 17.45 a degree"),
)  # fmt: skip


def check_levels(known: FullPosterior) -> None:
    """Refuse readings of levels that have a far likelier machine if they mean something else, by
    the posterior of the readings as they stand.

    Raises:
        InputError: naming file and setups, what they would mean and what to do.
    """
    problem = known.before.problem
    levels = [
        f"{source(f.readings)}, setup {s.name!r}"
        for _, f, _, s in problem.tool_setups
        if s.observation.angular
    ]
    if not levels:
        return
    least = known.evidence + REQUIRED_EVIDENCE + np.log(len(_LEVEL_INTERPRETATIONS))
    likelier = [(e, s) for s, e in _interpretation_evidence(known.before) if e > least]
    if likelier:
        _, sense = best_of(likelier, lambda one: one[0], LOG_ODDS_MARGIN)
        raise InputError(
            f"{'; '.join(levels)}: the readings of the level have a far likelier machine, and fit "
            f"it, {sense.clause}"
        )


def _interpretation_evidence(before: Estimate) -> Iterator[tuple[_LevelInterpretation, float]]:
    """Log of what the readings weigh with each other meaning that could be likelier."""
    problem, least = before.problem, _rough_evidence(before) + REQUIRED_EVIDENCE
    for sense in _LEVEL_INTERPRETATIONS:
        factors = tuple(
            f if f.on_legs else replace(f, readings=sense.applied_to(f.readings))
            for f in problem.factors
        )
        try:
            fit = solve(replace(problem, factors=factors), method="nested", start=before.x)
            found = full_posterior(fit) if _rough_evidence(fit) > least else None
        except NumericsError:
            continue
        if found is not None and found.converged:
            yield sense, found.evidence


def _rough_evidence(fit: Estimate) -> float:
    """The same where every effect may be off by some tolerances, up to what all meanings share."""
    known = signatures(fit)
    columns = known.columns * known.tolerance * _PRIOR_WIDTH
    inside = np.eye(columns.shape[1]) + columns.T @ columns
    seen = columns.T @ known.residual
    square = known.residual @ known.residual - seen @ np.linalg.solve(inside, seen)
    return float(-square / 2)
