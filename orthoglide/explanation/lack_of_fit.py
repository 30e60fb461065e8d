"""Lack of fit of a fit or a posterior: tests against the noise, and the largest residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orthoglide.explanation.causes import CredibleSets
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.explanation.linear_model import Scale
from orthoglide.explanation.search import State
from orthoglide.fit import Estimate
from orthoglide.fit.scores import chi2_p_value, cross_validation_improvement, smaller_p_value
from orthoglide.geometry import LEGS, Array
from orthoglide.machine import Machine
from orthoglide.numerals import plain
from orthoglide.observations import Readings
from orthoglide.observations.approach import Ints
from orthoglide.ordering import descending, ranked
from orthoglide.result import LackOfFit, SetupResidual

SIGNIFICANT = 0.003
"""Largest p-value of a significant lack of fit: one false alarm in 300."""


def estimate_lack_of_fit(estimate: Estimate) -> LackOfFit:
    """Return the lack of fit of a fit: :attr:`Scores.lack_of_fit_p`."""
    p = estimate.scores.lack_of_fit_p
    p = p if np.isfinite(p) else 1.0
    return LackOfFit(p, base_p_value=p)


_SPANNED_DIRECTION = 1e-6  # least singular value of a direction of the stations, over the largest
_LEAST_DOF = 2.0  # least degrees of freedom for a test of the mean
_RELIABLE_NOISE_DOF = 30.0
"""Least degrees of freedom of a reliable noise estimate. With fewer, the noise may be off by a
quarter, so that noise larger than the repeats show is not rare; ``p_value`` allows for that."""

_STOPPED = "nothing else stands out of the noise and of the background of small errors"
_SUFFICIENT_P_VALUE = 0.05  # far above SIGNIFICANT: an explanation fits, no other is tried


def posterior_lack_of_fit(posterior: FullPosterior, sets: CredibleSets) -> LackOfFit:
    """Test the residual of the reported explanations against the noise.

    The likeliest explanation is tested first. If it does not fit, others that are nearly as likely
    are tested. Unreported causes count only as far as the posterior mean, which is the calibrated
    machine, fits too.

    With ``S = 1 + A D A^T`` the residual ``S^-1 r`` has the covariance ``S^-1`` if the explanation
    is right. Its chi2 is then a sum of squares, each weighted by an eigenvalue. Station means are
    tested, as they show best what repeats at every visit. If the noise is declared, all readings
    are tested as well, and the smaller p-value is corrected for two tests.

    The test is not made if the posterior did not converge.
    """
    mixture = posterior.mixture
    base_p = estimate_lack_of_fit(posterior.before).p_value
    untested = LackOfFit(base_p, posterior.background_scale, stopped=_STOPPED, base_p_value=base_p)
    if not posterior.converged:
        return replace(untested, p_value=np.nan, rare=mixture.probability_rare)
    reported = mixture.restricted_to(sets.names)
    p = unreported = _largest_p_value(posterior, reported)
    if p < _SUFFICIENT_P_VALUE:
        unreported = max(p, _largest_p_value(posterior, mixture.likely_explanations))
        scores = posterior.after.scores
        of_mean = scores.lack_of_fit_p if scores.dof >= _LEAST_DOF else np.inf
        p = max(p, min(unreported, of_mean))
    shaped = 0.0
    if mixture.linear.plate_shapes.any():
        shaped = _p_value(
            posterior, mixture.inverse_reading_covariance(*reported[0], plate_shapes=True)
        )
    counts_and_dof = posterior.before.problem.repeat_counts_and_dof
    few_repeats = any(dof < _RELIABLE_NOISE_DOF for _, dof in counts_and_dof)
    rare = mixture.probability_beyond_tolerance if few_repeats else mixture.probability_rare
    diffuse = base_p < SIGNIFICANT and _is_diffuse(posterior)
    return replace(
        untested, p_value=p, rare=rare, shaped=shaped, with_unreported=unreported,
        explained_within_tolerances=diffuse,
    )  # fmt: skip


def _is_diffuse(posterior: FullPosterior) -> bool:
    """Return whether a background within tolerances explains the readings.

    It must also predict stations that are left out better than the base alone, by more than the
    standard error.
    """
    mixture = posterior.mixture
    p = _p_value(posterior, mixture.inverse_reading_covariance((), mixture.likeliest_background()))
    if p < SIGNIFICANT:
        return False
    before, after = posterior.before, posterior.after
    improvement, error = cross_validation_improvement(before.rows, after.rows)
    return improvement > error


def _largest_p_value(
    posterior: FullPosterior, explanations: Sequence[tuple[State, Scale]]
) -> float:
    """Return the largest p-value of some explanations, or the first that suffices."""
    p = 0.0
    for state, scale in explanations:
        p = max(p, _p_value(posterior, posterior.mixture.inverse_reading_covariance(state, scale)))
        if p > _SUFFICIENT_P_VALUE:
            break
    return p


def _p_value(posterior: FullPosterior, inverse: Array) -> float:
    """Return the p-value of the residual, given the inverse covariance of an explanation."""
    linear, problem = posterior.mixture.linear, posterior.before.problem
    residual = inverse @ linear.residual
    vectors, singular, _ = np.linalg.svd(linear.stations, full_matrices=False)
    means = vectors[:, singular > _SPANNED_DIRECTION * singular.max(initial=1.0)]
    chi2, dof, _ = linear.station_remainder
    noise_dof, precision = problem.noise_dof, means.T @ inverse @ means
    p = _tail_probability(means.T @ residual, precision, chi2, dof, noise_dof)
    if dof == 0 and not np.isfinite(noise_dof) and not problem.shared_rounding_sd.any():
        p = smaller_p_value(p, _tail_probability(residual, inverse, 0.0, 0.0, np.inf))
    return p if np.isfinite(p) else 1.0


def _tail_probability(
    residual: Array, covariance: Array, chi2: float, dof: float, noise_dof: float
) -> float:
    """Return the p-value of a residual ``(k,)``, given its covariance, and of a further chi2."""
    weights = np.asarray(1 - np.linalg.eigvalsh(covariance), dtype=np.float64)
    total = float(residual @ residual) + chi2
    return chi2_p_value(total, round(len(residual) + dof), weights, noise_dof)


_MOST_STATIONS = 3  # stations with the largest residuals
_CLEAR_RATIO = 1.05
"""Least ratio of the largest residual to the next, for its posture to be named: readings to a
hundredth of a millimetre round a residual of a tenth by 5 % at most."""
_ROUNDING = 1e-6  # root mean square of a residual that is rounding, in sigmas


def residual_by_setup(estimate: Estimate) -> tuple[SetupResidual, ...]:
    """Return the residual of each setup of a dial and each axis of an instrument at the tool.

    The largest share of chi2 comes first. TCP points have no setup.
    """
    problem, found = estimate.problem, list[SetupResidual]()
    squares = problem.weighing.whiten(estimate.residuals) ** 2
    total = float(squares.sum())
    # The residual of readings without noise is rounding, which has no location.
    residuals = estimate.residuals * (total > len(squares) * _ROUNDING**2)
    squares = squares / total if residuals.any() else np.zeros_like(squares)
    for factor, rows in zip(problem.factors, problem.factor_rows, strict=True):
        if (readings := factor.readings).by_point:
            continue
        parts = np.column_stack([readings.setup, readings.axis])
        for part in np.unique(parts, axis=0):
            in_file = np.flatnonzero((parts == part).all(axis=1))
            in_problem = rows.start + in_file
            setup, residual = readings.setups[part[0]], residuals[in_problem]
            stations = problem.station[in_problem]
            _, first_rows, station = np.unique(stations, return_index=True, return_inverse=True)
            means = np.bincount(station, readings.sign[in_file] * residual) / np.bincount(station)
            order = descending(np.abs(means))
            by_size = in_file[first_rows[order]]
            _, at_command = np.unique(readings.command[by_size], axis=0, return_index=True)
            worst = by_size[np.sort(at_command)[:_MOST_STATIONS]]
            # With only two stations and a free datum, both residuals are equal.
            first, *others = np.abs(means[order]).tolist()
            is_clear = first > _CLEAR_RATIO * max(others[:1], default=0.0)
            positions = (
                _tool_positions(problem.machine, readings, worst) if readings.of_tool else ()
            )
            setup_residual = SetupResidual(
                setup=setup.name,
                kind=setup.kind,
                leg=setup.leg,
                axis=int(part[1]),
                share=float(squares[in_problem].sum()),
                rms=float(np.sqrt(np.mean(residual**2))),
                most=float(means[order[0]]),
                posture=readings.posture[worst[0]] if is_clear else "",
                command=readings.command[worst[0]],
                where=positions,
                file=readings.name,
            )
            found.append(setup_residual)
    return tuple(ranked(found, lambda setup_residual: setup_residual.share))


def _tool_positions(machine: Machine, campaign: Readings, rows: Ints) -> tuple[str, ...]:
    """Return the tool's positions in rows ``(n,)``, as text; without the height if it probes a
    plate.

    For a distance between two points, both positions are given.
    """
    kinematics = machine.spec.kinematics
    observation = campaign.setups[campaign.setup[rows[0]]].observation
    forward = machine.with_only({}).forward if kinematics is None else kinematics.places
    axes = LEGS[:2] if observation.touches else LEGS

    def words(point: Array) -> str:
        pairs = zip(axes, point, strict=False)
        return ", ".join(f"{axis} {plain(value * 1e3, 0)}" for axis, value in pairs)

    commands = (campaign.command, campaign.second) if observation.paired else (campaign.command,)
    ends = [map(words, forward(command[rows])) for command in commands]
    return tuple(" to ".join(points) for points in zip(*ends, strict=True))
