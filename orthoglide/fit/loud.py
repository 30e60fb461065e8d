"""Repeats that scatter by more than was declared of dials and of instruments at the tool.

Noise that is declared too small makes a broken machine of a sound one: what is left is held against
it. Repeats show the noise whatever the machine does, so they are held against it as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.fit.estimate import Estimate
from orthoglide.fit.problem import Problem
from orthoglide.fit.repeats import repeat_steps, total_variance
from orthoglide.geometry import Array
from orthoglide.machine_file import Instrument
from orthoglide.notes import Note
from orthoglide.numerals import compact
from orthoglide.observations import source

_CHANCE = 1e-3  # of readings as noisy as declared, of which it is said that they scatter by more
_ALIKE = 0.01  # the same of all other setups, from which single ones are not told
_FEW = 2  # setups that are named: more of them are no single dials
_FEWEST = 10.0  # degrees of freedom
_TIMES = 1.2  # the noise declared: less is not worth a word
_SEVERAL = 2.0  # times what was declared, rounding aside: then it was no estimate of this dial


@dataclass(frozen=True)
class _Repeats:
    """Repeats of a setup, about what the fit explains."""

    where: str  # its file and setup, for people
    apart: Array  # each less the visit before (k,), metres
    sigma: float  # standard deviation of one reading as declared, rounding counted, metres
    step: float  # of the dial, metres


def loud_dials(estimate: Estimate) -> Iterator[Note]:
    """A sentence on all dials whose repeats scatter by more than was declared, or on single ones.

    Nothing is said where the noise was taken from the repeats, or from what is usual.
    """
    problem = estimate.problem
    if (told := _told(problem)) is None:
        return
    figure, remedy = told
    every = _repeats(estimate)
    loud = [one for one in every if _is_loud([one], _CHANCE / len(every))]
    rest = [one for one in every if one not in loud]
    rather_all = 2 * len(loud) >= len(every) > 1 or len(loud) > _FEW or _is_loud(rest, _ALIKE, 1.0)
    if rather_all or (not loud and _is_loud(every)):
        yield Note(
            f"repeats of the dials scatter by {compact(_scatter(every) * 1e3, 2)} mm, where "
            f"{figure}: {remedy}, or look for what is loose",
            "scatter",
        )
        return
    for one in loud:
        yield Note(
            f"{one.where}: repeats scatter by {compact(_scatter([one]) * 1e3, 2)} mm, where "
            f"{figure}, which those of other setups agree with: look for what is loose on this "
            f"dial, its stand and its leg, and read the setup again",
            "scatter",
        )


def loud_instruments(estimate: Estimate) -> Iterator[Note]:
    """The same of each instrument at the tool of which the machine file says how it repeats."""
    problem = estimate.problem
    for k, factor, number, setup in problem.mounted:
        own, rows = factor.setup == number, problem.factor_rows[k]
        told = problem.machine.spec.instruments.get(setup.kind, Instrument()).repeatability
        if told is None or np.isfinite(factor.readings.sigma[own]).any():
            continue
        rest = replace(factor.readings, reading=estimate.residuals[rows]).subset(own)
        where = f"{source(factor.readings)}, setup {setup.name!r}"
        sigma = float(np.sqrt(np.mean(factor.noise.total[own] ** 2)))
        one = _Repeats(where, repeat_steps(rest), sigma, float(problem.step[rows][own].max()))
        if _is_loud([one]):
            yield Note(
                f"{where}: repeats scatter by {compact(_scatter([one]) * 1e3, 2)} "
                f"{setup.observation.unit}, where the machine file says "
                f"{compact(told * 1e3, 2)}: correct repeatability under "
                f"[instrument.{setup.kind}], or look for what is loose",
                "scatter",
            )


def is_misdeclared(estimate: Estimate) -> bool:
    """Whether dials that are loud scatter by several times what was declared of one, its rounding
    aside: what a curve takes up of such repeats may be scatter that was not reckoned with.
    """
    told = _declared(estimate.problem)
    if told is None or not any(loud_dials(estimate)):
        return False
    return _scatter(_repeats(estimate)) > _SEVERAL * told


def _declared(problem: Problem) -> float | None:
    """What was told of one dial's scatter, metres."""
    if problem.noise.source == "machine":
        return problem.machine.spec.dial.repeatability
    return problem.noise.declared if problem.noise.source == "declared" else None


def _told(problem: Problem) -> tuple[str, str] | None:
    """What was declared of the dials' noise, and where to correct it, as clauses."""
    declared = _declared(problem)
    if declared is None or not problem.campaigns:
        return None
    figure = compact(declared * 1e3, 2)
    if problem.noise.source == "machine":
        return f"the machine file says {figure}", "correct repeatability under [dial_mm]"
    return f"{figure} was declared", "correct what was declared"


def _repeats(estimate: Estimate) -> list[_Repeats]:
    """Repeats of every setup that has any."""
    problem, found = estimate.problem, []
    total = np.hypot(problem.sigma, problem.common)
    for campaign, rows in zip(problem.campaigns, problem.rows, strict=True):
        rest = campaign.with_readings(estimate.residuals[rows])
        for k in np.unique(campaign.setup).tolist():
            own = campaign.setup == k
            apart = repeat_steps(rest.subset(own))
            sigma = float(np.sqrt(np.mean(total[rows][own] ** 2)))
            where = f"{source(campaign)}, setup {campaign.setups[k].name!r}"
            if len(apart):
                found.append(_Repeats(where, apart, sigma, float(problem.step[rows][own].max())))
    return found


def _is_loud(several: Sequence[_Repeats], chance: float = _CHANCE, times: float = _TIMES) -> bool:
    """Whether noise as declared makes so much scatter less often than by some chance, and it is
    some times that noise.
    """
    from scipy.special import chdtrc

    count = sum(len(one.apart) for one in several)
    dof = 2 * count / 3  # differences of a run share readings
    if dof < _FEWEST:
        return False
    square = sum(float(np.sum(one.apart**2)) / 2 / one.sigma**2 for one in several) / count
    return bool(square > times**2 and chdtrc(dof, dof * square) < chance)


def _scatter(several: Sequence[_Repeats]) -> float:
    """Standard deviation of one reading but for its rounding, metres."""
    count, step = [len(one.apart) for one in several], np.array([one.step for one in several])
    total = [total_variance(np.mean(one.apart**2) / 2, one.step) for one in several]
    mean = float(np.average(total - step**2 / 12, weights=count))
    return float(np.sqrt(max(mean, 0.0)))
