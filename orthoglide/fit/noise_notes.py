"""The noise that a fit shows of each setup, and notes where it is larger or smaller than assumed.

With too small a declared noise, a sound machine appears faulty: the lack of fit is blamed on it.
Repeats show the noise whatever the machine does, so the declared noise is tested against them.
With readings in too large a unit (inches, degrees), readings and residuals are both small numbers,
and a faulty machine appears sound: the residuals are tested against the assumed noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.estimate import Estimate
from orthoglide.fit.problem import Problem
from orthoglide.fit.repeats import total_variance
from orthoglide.geometry import Array
from orthoglide.machine_file import Instrument
from orthoglide.notes import Note
from orthoglide.numerals import compact
from orthoglide.observations import Readings, Setup, source
from orthoglide.observations.repetition import repeat_steps

_CHANCE = 1e-3  # probability of a note on readings whose noise is as assumed
# Degrees of freedom that a test needs: noise alone leaves a tenth of itself once in 4e8 such setups
_MIN_DOF = 10.0

# Repeats that scatter by more than declared
_SUSPICIOUS_CHANCE = 0.01  # probability below which other setups count as noisier, too
_MAX_NAMED_SETUPS = 2  # setups that are named one by one: more of them have a common cause
_MIN_RATIO = 1.2  # smallest ratio to the declared noise that is reported

# Residuals that scatter by less than assumed. Inches are 25 times too small and degrees 57 times,
# but unmodelled errors of the machine remain in the residual, so the limit is a tenth; a fifth for
# noise that was declared, which is not as wrong as a usual figure.
_SMALL_RATIO, _SMALL_RATIO_DECLARED = 0.1, 0.2
_COMPUTED_NOISE = 1e-8  # metres or radians: readings of smaller noise are computed
_ALLOWED_RATIO = 2.0  # factor by which the declared noise may be too large without a note
_MAX_REPORTED_RATIO = 1e3  # ratio above which its value is not reported
_DECLARED, _FROM_REPEATS = "as declared", "from their repeats"
_FROM_MACHINE_FILE, _IN_MACHINE_FILE = "as the machine file has it", " in the machine file, "


@dataclass(frozen=True)
class NoiseScale:
    """Noise of the readings of one setup, or of several together."""

    readings: Readings  # the table that they belong to
    setup: Setup  # of several the first
    rows: NDArray[np.intp]  # of all readings (m,)
    sigma: float  # standard deviation of one reading as assumed, root mean square, SI
    chi2: float  # of the residuals
    dof: float  # expected chi2: number of readings less parameters fitted to them

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


def noise_scales(estimate: Estimate) -> tuple[NoiseScale, ...]:
    """Return the noise of every setup, in the order of the files; TCP points count as one."""
    problem = estimate.problem
    square = problem.weighing.whiten(estimate.residuals) ** 2
    free = 1 - estimate.rows.leverage
    scales = []
    for factor, factor_slice in zip(problem.factors, problem.factor_rows, strict=True):
        readings = factor.readings
        for number in np.unique(readings.setup):
            chosen = (readings.setup == number) & factor.noise.weighted
            if chosen.any():
                rows = factor_slice.start + np.flatnonzero(chosen)
                sigma = float(np.sqrt(np.mean(factor.noise.total[chosen] ** 2)))
                chi2, dof = float(square[rows].sum()), max(float(free[rows].sum()), 0.0)
                scales.append(NoiseScale(readings, readings.setups[number], rows, sigma, chi2, dof))
    return tuple(scales)


def pool_noise_scales(several: Iterable[NoiseScale]) -> NoiseScale:
    """Return the noise of several setups of one table together."""
    scales = list(several)
    rows = [scale.rows for scale in scales]
    variance = np.average([s.sigma**2 for s in scales], weights=[*map(len, rows)])
    return replace(
        scales[0], rows=np.concatenate(rows), sigma=float(np.sqrt(variance)),
        chi2=sum(s.chi2 for s in scales), dof=sum(s.dof for s in scales),
    )  # fmt: skip


# Noise larger than declared -------------------------------------------------------------------


@dataclass(frozen=True)
class _Repeats:
    """Repeat differences of the residuals of one setup."""

    label: str  # file and setup, for people
    differences: Array  # each repeat minus the visit before (k,), metres
    sigma: float  # declared standard deviation of one reading, rounding included, metres
    resolution: float  # of the dial, metres


def noisy_dials(estimate: Estimate) -> Iterator[Note]:
    """Yield a note on all dials, or one for each of a few setups, whose repeats scatter by more
    than declared; nothing if the noise comes from the repeats, or is the usual figure.
    """
    problem = estimate.problem
    declared = _declared_dial_noise(problem)
    if declared is None or not problem.campaigns:
        return
    figure, remedy = f"{compact(declared * 1e3, 2)} was declared", "correct what was declared"
    if problem.noise.source == "machine":
        figure = f"the machine file says {compact(declared * 1e3, 2)}"
        remedy = "correct repeatability under [dial_mm]"
    repeats = _dial_repeats(estimate)
    noisy = [setup for setup in repeats if _is_noisy([setup], _CHANCE / len(repeats))]
    others = [setup for setup in repeats if setup not in noisy]
    have_common_cause = (
        2 * len(noisy) >= len(repeats) > 1
        or len(noisy) > _MAX_NAMED_SETUPS
        or _is_noisy(others, _SUSPICIOUS_CHANCE, 1.0)
    )
    if have_common_cause or (not noisy and _is_noisy(repeats)):
        yield Note(
            f"repeats of the dials scatter by {compact(_scatter(repeats) * 1e3, 2)} mm, where "
            f"{figure}: {remedy}, or look for what is loose",
            "scatter",
        )
        return
    for setup in noisy:
        yield Note(
            f"{setup.label}: repeats scatter by {compact(_scatter([setup]) * 1e3, 2)} mm, where "
            f"{figure}, which those of other setups agree with: look for what is loose on this "
            f"dial, its stand and its leg, and read the setup again",
            "scatter",
        )


def noisy_instruments(estimate: Estimate) -> Iterator[Note]:
    """Yield a note for each instrument at the tool whose repeats scatter by more than the
    repeatability in the machine file.
    """
    problem = estimate.problem
    for k, factor, number, setup in problem.iter_tool_setups():
        chosen, rows = factor.setup == number, problem.factor_rows[k]
        declared = problem.machine.spec.instruments.get(setup.kind, Instrument()).repeatability
        if declared is None or np.isfinite(factor.readings.sigma[chosen]).any():
            continue
        residuals = replace(factor.readings, reading=estimate.residuals[rows])
        repeats = _repeats_of_setup(
            residuals, number, factor.noise.expected, problem.resolution[rows]
        )
        if _is_noisy([repeats]):
            yield Note(
                f"{repeats.label}: repeats scatter by {compact(_scatter([repeats]) * 1e3, 2)} "
                f"{setup.observation.unit}, where the machine file says "
                f"{compact(declared * 1e3, 2)}: correct repeatability under "
                f"[instrument.{setup.kind}], or look for what is loose",
                "scatter",
            )


def _declared_dial_noise(problem: Problem) -> float | None:
    """Return the declared standard deviation of one dial, metres, or ``None``."""
    if problem.noise.source == "machine":
        return problem.machine.spec.dial.repeatability
    return problem.noise.declared if problem.noise.source == "declared" else None


def _dial_repeats(estimate: Estimate) -> list[_Repeats]:
    """Return the repeats of every dial setup that has any."""
    problem, dial_repeats = estimate.problem, []
    expected = np.concatenate([f.noise.expected for f in problem.leg_factors])
    for campaign, rows in zip(problem.campaigns, problem.leg_rows, strict=True):
        residuals = campaign.with_readings(estimate.residuals[rows])
        for k in np.unique(campaign.setup).tolist():
            repeats = _repeats_of_setup(residuals, k, expected[rows], problem.resolution[rows])
            if len(repeats.differences):
                dial_repeats.append(repeats)
    return dial_repeats


def _repeats_of_setup(residuals: Readings, number: int, sigma: Array, step: Array) -> _Repeats:
    """Return the repeats of one setup.

    Args:
        residuals: a table with residuals in the place of its readings ``(n,)``, metres or radians.
        number: of the setup.
        sigma: assumed noise of each row ``(n,)``, metres or radians.
        step: resolution of each row ``(n,)``, metres or radians.
    """
    rows = residuals.setup == number
    return _Repeats(
        f"{source(residuals)}, setup {residuals.setups[number].name!r}",
        repeat_steps(residuals.subset(rows)),
        float(np.sqrt(np.mean(sigma[rows] ** 2))),
        float(step[rows].max()),
    )


def _is_noisy(
    repeats: Sequence[_Repeats], chance: float = _CHANCE, ratio: float = _MIN_RATIO
) -> bool:
    """Return whether the repeats scatter by more than ``ratio`` the declared noise, and noise as
    declared would scatter as much with a probability below ``chance``.
    """
    from scipy.special import chdtrc

    count = sum(len(setup_repeats.differences) for setup_repeats in repeats)
    dof = 2 * count / 3  # successive differences share readings
    if dof < _MIN_DOF:
        return False
    mean_square = (
        sum(
            float(np.sum(setup_repeats.differences**2)) / 2 / setup_repeats.sigma**2
            for setup_repeats in repeats
        )
        / count
    )
    return bool(mean_square > ratio**2 and chdtrc(dof, dof * mean_square) < chance)


def _scatter(repeats: Sequence[_Repeats]) -> float:
    """Return the standard deviation of one reading without its rounding, metres."""
    count = [len(setup.differences) for setup in repeats]
    total = [total_variance(np.mean(s.differences**2) / 2, s.resolution) for s in repeats]
    rounding = np.array([setup.resolution for setup in repeats]) ** 2 / 12
    variance = float(np.average(total - rounding, weights=count))
    return float(np.sqrt(max(variance, 0.0)))


# Noise smaller than assumed -------------------------------------------------------------------


def small_residuals(estimate: Estimate) -> tuple[Note, ...]:
    """Return notes on readings that fit far better than their noise: one for each instrument, or
    else one for all readings.
    """
    return tuple(_small_by_instrument(estimate)) or tuple(_small_overall(estimate))


def _small_by_instrument(estimate: Estimate) -> Iterator[Note]:
    """Yield a note for each setup of an instrument at the tool, and for all dials of a file, whose
    residuals are a small fraction of the assumed noise.
    """
    problem = estimate.problem
    for table, scales in groupby(noise_scales(estimate), key=lambda scale: scale.readings):
        setups = list(scales)
        dials = bool(table.on_legs.all())
        for noise in [pool_noise_scales(setups)] if dials else setups:
            origin = _noise_origin(problem, noise)
            limit = _SMALL_RATIO_DECLARED if origin else _SMALL_RATIO
            # Dials with declared noise are tested by `_small_overall`.
            tested_overall = dials and problem.noise.source == "declared"
            testable = noise.sigma >= _COMPUTED_NOISE and noise.dof >= _MIN_DOF
            if not tested_overall and testable and noise.scale < limit:
                yield Note(_small_sentence(noise, origin), "quiet")


def _small_overall(estimate: Estimate) -> Iterator[Note]:
    """Yield a note if chi2 would be too small even for half of the declared noise."""
    from scipy.special import chdtr

    problem, scores = estimate.problem, estimate.scores
    all_declared = all(
        np.isfinite(f.readings.sigma).all() for f in problem.tool_factors if problem.leg_factors
    )
    if problem.noise.source != "declared" or not all_declared or estimate.sigma_scale > 1:
        return
    if chdtr(max(scores.dof, 1e-9), _ALLOWED_RATIO**2 * scores.chi2) < _CHANCE:
        times = np.sqrt(scores.dof / max(scores.chi2, 1e-300))
        yield Note(
            f"the readings scatter {compact(times, 2)} times less than the noise that was declared "
            f"({problem.single_reading_sd.said()}; chi2 {compact(scores.chi2, 2)} on "
            f"{scores.dof:.0f} degrees of freedom), so that faults may go unnoticed: correct the "
            f"declared noise, or the unit of the readings",
            "quiet",
        )


def _small_sentence(noise: NoiseScale, origin: str) -> str:
    """Return the sentence on readings with small residuals, and what to do about them."""
    table, setup = noise.readings, noise.setup
    unit, unit_suspected = ("mrad", "degrees") if setup.observation.angular else ("mm", "inches")
    ratio = 1 / max(noise.scale, 1 / _MAX_REPORTED_RATIO)
    too_large = ratio >= _MAX_REPORTED_RATIO
    count = f"more than {_MAX_REPORTED_RATIO:.0f}" if too_large else compact(ratio, 2)
    label = source(table)
    if table.on_legs.all():
        place = f"{_IN_MACHINE_FILE}[dial_mm]"
    elif table.by_point:
        place = " in a column sigma_mm"
    else:
        label = f"{label}, setup {setup.name!r}"
        place = f"{_IN_MACHINE_FILE}[instrument.{setup.kind}]"
    return (
        f"{label}: the readings are {count} times quieter than the noise assumed of them "
        f"({compact(noise.sigma * 1e3, 2)} {unit}, {origin or 'the usual figure'}): are they in "
        f"another unit, as {unit_suspected}? If not, "
        f"{'correct' if origin else 'declare'} the instrument's noise"
        f"{'' if origin == _DECLARED else place}"
    )


def _noise_origin(problem: Problem, noise: NoiseScale) -> str:
    """Return where the assumed noise comes from, in words; empty for the usual figure."""
    spec = problem.machine.spec
    if noise.readings.on_legs.all():
        if problem.noise.source == "repeats":
            return _FROM_REPEATS
        return _FROM_MACHINE_FILE if spec.dial.repeatability else ""
    table, kind = noise.readings, noise.setup.kind
    of_kind = np.array([s.kind == kind for s in table.setups])[table.setup]
    declared = problem.noise.source == "declared" and not problem.campaigns
    if declared or np.isfinite(table.sigma[of_kind]).all():
        return _DECLARED
    instrument = spec.instruments.get(kind)
    return _FROM_MACHINE_FILE if instrument is not None and instrument.repeatability else ""
