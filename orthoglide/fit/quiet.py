"""Readings that agree with a fit far better than their noise lets expect.

An instrument may be better than was assumed. But readings in a unit that is too large, as inches
or degrees, are small numbers, and so is what a fit leaves of them: the machine looks sound.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.estimate import Estimate
from orthoglide.fit.least_squares import fitted_basis
from orthoglide.fit.problem import Factor, Problem
from orthoglide.notes import Note
from orthoglide.numerals import compact
from orthoglide.observations import source

# Of the noise; inches are 25 times too small, degrees 57 times, and what the machine does in a way
# that no fit explains is left of them as well.
_QUIET = {"usual": 0.1, "told": 0.2}
_FEWEST = 10.0  # degrees of freedom: noise alone leaves a tenth of itself once in 4e8 such setups
_EXACT = 1e-8  # metres or radians: whose noise is declared this small is not measured but computed
_DECLARED = "as declared"
_FROM_FILE, _IN_FILE = "as the machine file has it", " in the machine file, "
_HALF = 2.0  # times that noise may be declared too large without a word
_CHANCE = 1e-3  # of readings with half of the noise declared that are said to be too quiet
_MOST = 1e3  # times quieter, from which the figure says nothing more


class _Part(NamedTuple):
    """Readings of one instrument."""

    where: str  # its file and setup, for people
    rows: NDArray[np.intp]  # of all readings (m,)
    told: str  # where the noise comes from, in words; empty of the usual figure
    declare: str  # where it may be declared


def quieter(estimate: Estimate) -> tuple[Note, ...]:
    """Sentences on readings that are too quiet: by instrument, or else all together."""
    return tuple(_by_part(estimate)) or tuple(_all_together(estimate))


def _by_part(estimate: Estimate) -> Iterator[Note]:
    """A sentence for every setup of an instrument at the tool, and for all dials of a file, that is
    left with next to nothing of its noise.
    """
    problem, left = estimate.problem, estimate.residuals
    square = problem.weighing.whiten(left) ** 2
    leverage = None
    for part in _parts(problem):
        limit = _QUIET["told" if part.told else "usual"] ** 2
        rows = part.rows
        sigma = float(np.sqrt(np.mean(problem.sigma[rows] ** 2 + problem.common[rows] ** 2)))
        if sigma < _EXACT or len(rows) < _FEWEST or square[rows].mean() > limit:
            continue
        if leverage is None:
            basis = fitted_basis(problem, estimate.nuisance, estimate.at)
            leverage = np.sum(basis[: len(left)] ** 2, axis=1)
        dof = float(np.sum(1 - leverage[rows]))
        if dof >= _FEWEST and (ratio := float(square[rows].sum()) / dof) < limit:
            yield Note(_said(problem, part, sigma, ratio), "quiet")


def _all_together(estimate: Estimate) -> Iterator[Note]:
    """Readings that scatter so much less than was declared that the figure must be wrong: a chi2
    that would be too small even if they had half of that noise.
    """
    from scipy.special import chdtr

    problem, scores = estimate.problem, estimate.scores
    told = all(np.isfinite(f.readings.sigma).all() for f in problem.tool if problem.on_legs)
    if problem.noise.source != "declared" or not told or estimate.sigma_scale > 1:
        return
    if chdtr(max(scores.dof, 1e-9), _HALF**2 * scores.chi2) < _CHANCE:
        times = np.sqrt(scores.dof / max(scores.chi2, 1e-300))
        yield Note(
            f"the readings scatter {compact(times, 2)} times less than the noise that was declared "
            f"({problem.one_reading.said()}; chi2 {compact(scores.chi2, 2)} on "
            f"{scores.dof:.0f} degrees of freedom): correct it, as faults may hide in it, or the "
            f"unit of the readings",
            "quiet",
        )


def _said(problem: Problem, part: _Part, sigma: float, ratio: float) -> str:
    turned = bool(problem.turned[part.rows[0]])
    unit, other = ("mrad", "degrees") if turned else ("mm", "inches")
    times = 1 / np.sqrt(max(ratio, _MOST**-2))
    count = f"more than {_MOST:.0f}" if times >= _MOST else compact(times, 2)
    where = "" if part.told == _DECLARED else part.declare
    return (
        f"{part.where}: the readings are {count} times quieter than the noise assumed of them "
        f"({compact(sigma * 1e3, 2)} {unit}, {part.told or 'the usual figure'}): are they in "
        f"another unit, as {other}? If not, "
        f"{'correct' if part.told else 'declare'} the instrument's noise{where}"
    )


def _parts(problem: Problem) -> Iterator[_Part]:
    for factor, span in zip(problem.factors, problem.factor_rows, strict=True):
        rows, readings = np.arange(span.start, span.stop), factor.readings
        if factor.on_legs:
            if problem.noise.source != "declared":  # of which notes speak that count all readings
                told = _FROM_FILE if problem.machine.spec.dial.repeatability else ""
                told = "from their repeats" if problem.noise.source == "repeats" else told
                yield _Part(source(readings), rows, told, f"{_IN_FILE}[dial_mm]")
            continue
        for k, setup in enumerate(readings.setups):
            own = factor.setup == k
            where = "" if readings.by_point else f", setup {setup.name!r}"
            declare = f"{_IN_FILE}[instrument.{setup.kind}]"
            if own.any():
                yield _Part(
                    f"{source(readings)}{where}", rows[own],
                    _of_tool(problem, factor, own, setup.kind),
                    " in a column sigma_mm" if readings.by_point else declare,
                )  # fmt: skip


def _of_tool(problem: Problem, factor: Factor, own: NDArray[np.bool_], kind: str) -> str:
    told = np.isfinite(factor.readings.sigma[own]).all()
    if told or (problem.noise.source == "declared" and not problem.campaigns):
        return _DECLARED
    instrument = problem.machine.spec.instruments.get(kind)
    return _FROM_FILE if instrument is not None and instrument.repeatability else ""
