"""The noise that a fit shows of each setup, and notes where it is larger or smaller than assumed.

With too small a declared noise, a sound machine appears faulty: the lack of fit is blamed on it.
Repeats show the noise whatever the machine does: where they refute what was declared, the noise is
enlarged before the fit, and a note says so. With readings in too large a unit (inches, degrees),
readings and residuals are both small numbers, and a faulty machine appears sound: the residuals are
tested against the assumed noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.fit.estimate import Estimate
from orthoglide.fit.noise import RowNoise
from orthoglide.fit.problem import Problem
from orthoglide.notes import Note
from orthoglide.numerals import compact
from orthoglide.observations import Readings, Setup, source

_CHANCE = 1e-3  # probability of a note on readings whose noise is as assumed
# Degrees of freedom that a test needs: noise alone leaves a tenth of itself once in 4e8 such setups
_MIN_DOF = 10.0
_MAX_NAMED_SETUPS = 2  # setups that are named one by one: more of them have a common cause

# Residuals that scatter by less than assumed. Inches are 25 times too small and degrees 57 times,
# but unmodelled errors of the machine remain in the residual, so the limit is a tenth; a fifth for
# noise that was declared, which is not as wrong as a usual figure.
_SMALL_RATIO, _SMALL_RATIO_DECLARED = 0.1, 0.2
_COMPUTED_NOISE = 1e-8  # metres or radians: readings of smaller noise are computed
_ALLOWED_RATIO = 2.0  # factor by which the declared noise may be too large without a note
_MAX_REPORTED_RATIO = 1e3  # ratio above which its value is not reported

_ORIGINS = {
    "declared": "as declared",
    "repeats": "from their repeats",
    "machine": "as the machine file has it",
    "residuals": "from their residuals",
    "usual": "the usual figure",
}


@dataclass(frozen=True)
class NoiseScale:
    """Noise of the readings of one setup, or of several together."""

    readings: Readings  # the table that they belong to
    setup: Setup  # of several the first
    noise: RowNoise  # as assumed, of the weighted readings (m,)
    chi2: float  # of the residuals
    dof: float  # expected chi2: number of readings less parameters fitted to them

    @property
    def sigma(self) -> float:
        """Standard deviation of one reading as assumed, root mean square, SI."""
        return float(np.sqrt(np.mean(self.noise.total**2)))

    @property
    def origin(self) -> str:
        """Source of the assumed noise."""
        return min({*self.noise.source.tolist()} - {"declared"}, default="declared")

    @property
    def scale(self) -> float:
        """Ratio of the noise that the residuals show to the noise assumed; nan without degrees of
        freedom.
        """
        return float(np.sqrt(self.chi2 / self.dof)) if self.dof > 0 else float("nan")

    @property
    def scale_sigma(self) -> float:
        """Standard deviation of :attr:`scale`: that of a root of a chi2."""
        return self.scale / float(np.sqrt(2 * self.dof)) if self.dof > 0 else float("nan")


def noise_scales(estimate: Estimate, *, dials_together: bool = False) -> tuple[NoiseScale, ...]:
    """Return the noise of every setup, in the order of the files; TCP points count as one setup,
    and all dials of a file if they are taken together.
    """
    problem = estimate.problem
    square = problem.weighing.whiten(estimate.residuals) ** 2
    free = 1 - estimate.rows.leverage
    scales = []
    for factor, part in zip(problem.factors, problem.factor_rows, strict=True):
        readings, number = factor.readings, factor.setup
        if dials_together and factor.on_legs:
            number = np.zeros_like(number)
        for k in np.unique(number):
            rows = (number == k) & factor.noise.weighted
            if rows.any():
                chi2, dof = float(square[part][rows].sum()), float(free[part][rows].sum())
                noise = factor.noise.subset(rows)
                scales.append(NoiseScale(readings, readings.setups[k], noise, chi2, max(dof, 0.0)))
    return tuple(scales)


def _section(problem: Problem, setup: Setup) -> str:
    """Return the section of the machine file that declares the noise of a kind of readings."""
    has_section = setup.kind in problem.machine.spec.instruments
    return (
        f"[instrument.{setup.kind}]" if has_section or not setup.observation.dials else "[dial_mm]"
    )


def noisy_repeats(estimate: Estimate) -> Iterator[Note]:
    """Yield a note on all readings of a kind, or one for each of a few setups, whose repeats refute
    the noise that was declared of them.
    """
    problem = estimate.problem
    for kind in sorted(problem.noise.refuted):
        setups = [scale for scale in noise_scales(estimate) if scale.setup.kind == kind]
        enlarged = [
            (s.noise.sigma > s.noise.expected) & ~np.isin(s.noise.source, ("repeats", "residuals"))
            for s in setups
        ]
        noisy = [scale for scale, rows in zip(setups, enlarged, strict=True) if rows.any()]
        origin = noisy[0].origin if noisy else "usual"
        if origin not in ("declared", "machine"):
            continue
        observation, unit = noisy[0].setup.observation, noisy[0].setup.observation.unit
        assumed = _without_rounding(noisy, "expected")
        if origin == "declared":
            figure, remedy = f"{assumed} was declared", "correct what was declared"
        else:
            figure = f"the machine file says {assumed}"
            remedy = f"correct repeatability under {_section(problem, noisy[0].setup)}"
        if 2 * len(noisy) >= len(setups) or len(noisy) > _MAX_NAMED_SETUPS:
            what = "the dials" if observation.on_leg else f"the {kind} readings"
            yield Note(
                f"repeats of {what} scatter by {_without_rounding(noisy)} {unit}, where {figure}: "
                f"{remedy}, or look for what is loose",
                "scatter",
            )
            continue
        parts = "instrument and its stand"
        if observation.on_leg:
            parts = "dial, its stand and its leg"
        for scale in noisy:
            yield Note(
                f"{source(scale.readings)}, setup {scale.setup.name!r}: repeats scatter by "
                f"{_without_rounding([scale])} {unit}, where {figure}, which those of other setups "
                f"agree with: look for what is loose on this {parts}, and read the setup again",
                "scatter",
            )


def _without_rounding(scales: Sequence[NoiseScale], kind: str = "total") -> str:
    """Return the median noise of a reading without its rounding, as text in thousandths of SI;
    ``kind``: ``"total"`` or ``"expected"``.
    """
    variance = [getattr(one.noise, kind) ** 2 - one.noise.step**2 / 12 for one in scales]
    return compact(1e3 * float(np.sqrt(max(np.median(np.concatenate(variance)), 0.0))), 2)


def small_residuals(estimate: Estimate) -> tuple[Note, ...]:
    """Return notes on readings that fit far better than their noise: one for each setup at the tool
    and for all dials of a file, or else one for all readings.
    """
    from scipy.special import chdtr

    problem, scores, notes = estimate.problem, estimate.scores, list[Note]()
    all_declared = problem.noise.source == "declared" and all(
        np.isfinite(f.readings.sigma).all() for f in problem.tool_factors if problem.leg_factors
    )
    for noise in noise_scales(estimate, dials_together=True):
        limit = _SMALL_RATIO if noise.origin == "usual" else _SMALL_RATIO_DECLARED
        # Dials with declared noise are tested with all other readings.
        tested = not (noise.setup.leg >= 0 and problem.noise.source == "declared")
        testable = noise.sigma >= _COMPUTED_NOISE and noise.dof >= _MIN_DOF
        if tested and testable and noise.scale < limit:
            notes.append(Note(_small_sentence(problem, noise), "quiet"))
    if notes or not all_declared or estimate.sigma_scale > 1:
        return tuple(notes)
    if chdtr(max(scores.dof, 1e-9), _ALLOWED_RATIO**2 * scores.chi2) < _CHANCE:
        times = np.sqrt(scores.dof / max(scores.chi2, 1e-300))
        text = (
            f"the readings scatter {compact(times, 2)} times less than the noise that was declared "
            f"({problem.single_reading_sd.said()}; chi2 {compact(scores.chi2, 2)} on "
            f"{scores.dof:.0f} degrees of freedom), so that faults may go unnoticed: correct the "
            f"declared noise, or the unit of the readings"
        )
        notes.append(Note(text, "quiet"))
    return tuple(notes)


def _small_sentence(problem: Problem, noise: NoiseScale) -> str:
    """Return the sentence on readings with small residuals, and what to do about them."""
    table, setup, origin = noise.readings, noise.setup, noise.origin
    unit, unit_suspected = ("mrad", "degrees") if setup.observation.angular else ("mm", "inches")
    ratio = 1 / max(noise.scale, 1 / _MAX_REPORTED_RATIO)
    too_large = ratio >= _MAX_REPORTED_RATIO
    count = f"more than {_MAX_REPORTED_RATIO:.0f}" if too_large else compact(ratio, 2)
    place = "" if setup.leg >= 0 or table.by_point else f", setup {setup.name!r}"
    section = f" in the machine file, {_section(problem, setup)}" * (origin != "declared")
    return (
        f"{source(table)}{place}: the readings are {count} times quieter than the noise assumed of "
        f"them ({compact(noise.sigma * 1e3, 2)} {unit}, {_ORIGINS[origin]}): are they in another "
        f"unit, as {unit_suspected}? If not, {'declare' if origin == 'usual' else 'correct'} the "
        f"instrument's noise{section}"
    )
