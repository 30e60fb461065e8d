"""A level that counts in the opposite direction, is read about the other axis, or shows degrees.

Zeros and leg lengths do not turn the platform, so the base model fits such readings equally well,
and causes that turn it are found for them. Only the evidence of the full model prefers the correct
interpretation.
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
    """An alternative interpretation of the readings of a level."""

    signs: tuple[float, float] = (1.0, 1.0)  # factors of readings about x and about y
    exchanged: bool = False  # whether x and y are exchanged
    factor: float = 1.0  # of all readings
    clause: str = ""  # how the readings fit, and what to do

    def applied_to(self, points: Readings) -> Readings:
        """Return the readings with that interpretation."""
        angular = points.angular
        sign = np.where(angular, np.take(self.signs, points.axis % 2), 1.0) * points.sign
        axis = np.where(angular & self.exchanged, 1 - points.axis, points.axis)
        reading = np.where(angular, self.factor, 1.0) * points.reading
        return replace(points, sign=sign, axis=axis, reading=reading)


_LEVEL_INTERPRETATIONS = (
    _LevelInterpretation((-1, -1), clause="with the opposite sign: look which way it counts, "
                         "right-handed about x and y, and put -x and -y as directions"),
    _LevelInterpretation((-1, 1), clause="with the opposite sign about x: look which way it counts "
                         "there, and put -x as direction"),
    _LevelInterpretation((1, -1), clause="with the opposite sign about y: look which way it counts "
                         "there, and put -y as direction"),
    _LevelInterpretation(exchanged=True, clause="with x and y exchanged: correct the directions"),
    _LevelInterpretation(factor=_DEGREE, clause="as degrees: put them into milliradians, 17.45 a "
                         "degree"),
)  # fmt: skip


def check_levels(posterior: FullPosterior) -> None:
    """Refuse readings of levels that are far likelier with another interpretation than with the
    posterior of the readings as they stand.

    Raises:
        InputError: names file and setups, the interpretation, and what to do.
    """
    problem = posterior.before.problem
    levels = [
        f"{source(f.readings)}, setup {s.name!r}"
        for _, f, _, s in problem.iter_tool_setups()
        if s.observation.angular
    ]
    if not levels:
        return
    threshold = posterior.evidence + REQUIRED_EVIDENCE + np.log(len(_LEVEL_INTERPRETATIONS))
    likelier = [(e, s) for s, e in _interpretation_evidence(posterior.before) if e > threshold]
    if likelier:
        _, interpretation = best_of(likelier, lambda one: one[0], LOG_ODDS_MARGIN)
        raise InputError(
            f"{'; '.join(levels)}: the readings of the level have a far likelier machine, and fit "
            f"it, {interpretation.clause}"
        )


def _interpretation_evidence(estimate: Estimate) -> Iterator[tuple[_LevelInterpretation, float]]:
    """Yield each interpretation that may be likelier, with its log evidence."""
    problem, threshold = estimate.problem, _rough_evidence(estimate) + REQUIRED_EVIDENCE
    for interpretation in _LEVEL_INTERPRETATIONS:
        factors = tuple(
            f if f.on_legs else replace(f, readings=interpretation.applied_to(f.readings))
            for f in problem.factors
        )
        try:
            fit = solve(replace(problem, factors=factors), method="nested", start=estimate.x)
            posterior = full_posterior(fit) if _rough_evidence(fit) > threshold else None
        except NumericsError:
            continue
        if posterior is not None and posterior.converged:
            yield interpretation, posterior.evidence


def _rough_evidence(fit: Estimate) -> float:
    """Return the log evidence with every effect off by some tolerances, up to a common constant."""
    linear = signatures(fit)
    columns = linear.columns * linear.tolerance * _PRIOR_WIDTH
    inner = np.eye(columns.shape[1]) + columns.T @ columns
    projected = columns.T @ linear.residual
    square = linear.residual @ linear.residual - projected @ np.linalg.solve(inner, projected)
    return float(-square / 2)
