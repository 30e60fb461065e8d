"""The posterior of the full model: base parameters, effects, free-form errors and data faults.

The readings are linearised at the posterior mean, repeatedly until the mean is stationary.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.effects.free_form import FreeForm
from orthoglide.errors import ClosureError, NumericsError, SolverError
from orthoglide.explanation.columns import LinearisedModel, linearise_full_model
from orthoglide.explanation.fault_columns import FaultColumns, FaultKey, with_commands_corrected
from orthoglide.explanation.faults import Fault
from orthoglide.explanation.mixture import LEAST_PROBABILITY, AveragedMoments, Mixture
from orthoglide.fit import Estimate
from orthoglide.fit.factors import NuisanceBlock
from orthoglide.fit.least_squares import linearise, nuisances, update_instrument_poses
from orthoglide.fit.solving import make_estimate, solve, widen_priors
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.notes import Note
from orthoglide.ordering import best_of
from orthoglide.parameters import Parameter

_LINEARISATIONS = 3
_DECISIVE_LOG_BAYES_FACTOR = 3.0
"""Log Bayes factor (twenty to one) that decides between a base beyond its tolerances and all other
causes; below it both are reported."""

_CONVERGED = 0.1
"""Root mean square, in sigmas of a reading, by which the prediction may still differ from its
linearisation: 0.01 of chi2 per reading, negligible for any cause."""

_NOT_LINEAR = 1.25
"""Root mean square, in sigmas, from which the linearisation is not valid: more than noise. Machines
off by all their tolerances reach 1.1; causes mistaken for a wrong command reach 1.3 and more."""

_COMMAND_CONVERGED = 2e-6
"""Metres: a change of a wrong command's estimate below this counts as converged."""

_LEAST_PRIOR_VARIANCE = 1e-10
"""Squared tolerances: prior variance up to which a parameter is represented by its twin."""

_DETECTABLE_TOLERANCES, _DETECTABLE_SIGMAS = 3.0, 3.0
"""A parameter is invisible if three tolerances of it change all readings by under three sigmas."""


@dataclass(frozen=True, eq=False, repr=False)
class FullPosterior:
    """Posterior of the full model, given the readings."""

    before: Estimate  # the fit of the base model
    linearised: LinearisedModel  # the readings linearised at the mean
    mixture: Mixture  # of the explanations
    # alternative fit with the base far beyond its tolerances, which the readings do not rule out
    alternative: Estimate | None = None

    @property
    def mean(self) -> Array:
        """Posterior mean of all coefficients, in their units ``(C,)``."""
        return self.mixture.mean

    @property
    def evidence(self) -> float:
        """Log evidence of the best explanation, less the log factor of widened base priors."""
        widths = np.array([u.prior_width for u in self.before.problem.unknowns])
        fit = self.mixture.log_weight(self.mixture.best) - self.linearised.unexplainable_chi2 / 2
        return float(fit - np.log(widths).sum())

    @property
    def chi2_per_dof(self) -> float:
        """Chi2 per degree of freedom of the best explanation, its priors counted."""
        return self.mixture.chi2 / max(len(self.mixture.linear.residual), 1)

    @property
    def active_faults(self) -> tuple[FaultColumns, ...]:
        """Data faults and changes that are active in the best explanation."""
        by_name = {s.name: s for s in self.linearised.suspects}
        names = [self.mixture.linear.groups[k].name for k, _ in self.mixture.best]
        return tuple(by_name[name] for name in names if name in by_name)

    def sized_fault(self, suspect: FaultColumns) -> Fault:
        """Return an active data fault with its size in the best explanation."""
        mixture = self.mixture
        names = [g.name for g in mixture.linear.groups]
        at = mixture.linear.groups[names.index(suspect.name)].coefficients
        return suspect.with_sizes(mixture.likeliest_mean(mixture.best)[at])

    @property
    def next_point(self) -> Array:
        """Next point of linearisation ``(P,)``, SI: the mean, inactive dial effects at zero."""
        known, effect_of = (
            self.linearised.parameter_count,
            self.before.problem.machine.catalogue.effect_of,
        )
        of_dial = np.array([effect_of(n).of_dial for n in self.linearised.problem.names])
        for group, _ in self.mixture.best:
            places = self.mixture.linear.groups[group].coefficients
            of_dial[places[places < known]] = False
        return np.where(of_dial, 0.0, (self.mean * self.linearised.units)[:known])

    @cached_property
    def moments(self) -> AveragedMoments:
        """Mean and covariance averaged over all explanations, in units of the coefficients."""
        return self.mixture.averaged_moments(self.linearised.parameter_count)

    @cached_property
    def covariance(self) -> Array:
        """Posterior covariance of all coefficients ``(C, C)``.

        Translations of the whole machine keep their full tolerances as prior, whatever the scale of
        the background.
        """
        count, along = self.linearised.parameter_count, self.linearised.translations
        seen = self.mixture.linear.columns[:, :count] @ along
        missing = max(1 - min(self.background_scale, 1.0) ** 2, 1e-6)
        spread = np.linalg.inv(np.eye(along.shape[1]) / missing + seen.T @ seen)
        found = self.moments.covariance.copy()
        found[:count, :count] += along @ spread @ along.T
        return found

    @cached_property
    def _full_tolerance_variance(self) -> Array:
        """Variance ``(C,)`` of each shrunk coefficient under its full tolerance; 0 elsewhere.

        A small background scale is learned from visible coefficients and only assumed for invisible
        ones. A later visit with another sheet must not be tested against that assumption.
        """
        found, at = np.zeros(len(self.covariance)), np.arange(self.linearised.parameter_count)
        variance, spike = self.mixture.likeliest_variance(at)
        held = (spike < 1.0) & (variance < spike) & (spike > _LEAST_PRIOR_VARIANCE)
        precision = 1 / variance[held] - 1 / spike[held] + 1.0
        found[at[held]] = 1 / precision
        return found

    @property
    def converged(self) -> bool:
        """True if the linearisation is valid at the mean, which fits no worse than the base."""
        before, after = self.before.scores, self.after.scores
        # Few readings leave no degree of freedom: a chi2 difference below one is negligible.
        near = after.chi2 <= before.chi2 + max(after.dof, 1.0)
        return near and self.linearised.linearisation_error < _NOT_LINEAR

    @property
    def background_scale(self) -> float:
        """Posterior mean scale of inactive effects, in tolerances."""
        return self.mixture.mean_scales[0]

    @cached_property
    def invisible(self) -> tuple[Parameter, ...]:
        """Parameters beyond the base that these readings cannot detect at three tolerances.

        Their signature is too small, or is explained by the base, the instruments' nuisances or a
        plate's shape.
        """
        columns = self.mixture.scales[0].basis.columns
        place = {n: k for k, n in enumerate(self.linearised.problem.names)}
        plate = {e.name for e in self.linearised.problem.machine.catalogue.effects if e.of_body}

        def shown(name: Parameter) -> float:
            # A plate has one shape, however many setups probe it.
            same = [n for n in place if (n.effect, n.direction) == (name.effect, name.direction)]
            each = same if name.effect in plate else [name]
            return _DETECTABLE_TOLERANCES * float(
                np.linalg.norm(columns[:, [place[n] for n in each]].sum(1))
            )

        return tuple(n for n in self.linearised.varied_parameters if shown(n) < _DETECTABLE_SIGMAS)

    @cached_property
    def free_form_errors(self) -> tuple[FreeForm, ...]:
        """Free-form errors probable enough to enter the calibrated machine."""
        likely = {
            g.name
            for g, p in zip(self.mixture.linear.groups, self.mixture.inclusion, strict=True)
            if g.free_form and p > LEAST_PROBABILITY
        }
        return tuple(
            p for p in self.linearised.free_form_errors if p.name in likely and p.of_machine
        )

    def machine_parameters(self, mean: Array) -> tuple[tuple[str, ...], Array, Array]:
        """Return names, values (SI) and weights by coefficient of the last campaign's machine.

        Args:
            mean: of all coefficients ``(C,)``.
        """
        names, matrix = self.linearised.problem.machine_parameters(
            self.linearised.problem.last_factor
        )
        scale, start = self.linearised.units, self.linearised.parameter_count
        weights = np.hstack([matrix, np.zeros((len(names), len(scale) - start))])
        found = list(names)
        for place in self.free_form_errors:
            at = self.linearised.coefficients(place)
            rows = np.zeros((len(at), len(scale)))
            rows[np.arange(len(at)), at] = 1.0
            weights, found = np.vstack([weights, rows]), [*found, *place.effect.motions]
        weights = weights * scale
        return tuple(found), weights @ mean, weights

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine: posterior mean and covariance."""
        start = self.before.problem.machine
        known = start.catalogue
        start = start.with_effects(
            p.effect for p in self.free_form_errors if p.effect.name not in known
        )
        names, values, weights = self.machine_parameters(self.mean)
        spread, alone = (
            weights @ self.covariance @ weights.T,
            weights**2 @ self._full_tolerance_variance,
        )
        kept = dict(zip(names, values.tolist(), strict=True))
        return start.with_posterior(kept, Posterior(names, values, spread, alone))

    @cached_property
    def after(self) -> Estimate:
        """Estimate at the posterior mean, scored, with the learned prior in place of tolerances."""
        about, mixture, prior = self.linearised, self.mixture, self.moments.prior
        count, scale = about.parameter_count, about.units
        known = _inverse_root(prior[:count, :count]) / scale[:count]
        earlier = self.before.problem
        rows, target = [known], [np.zeros(len(known))]
        if earlier.earlier_posterior is not None:
            matrix, goal = about.prior_rows
            rows, target = [*rows, matrix], [*target, goal]
        problem = replace(
            about.problem,
            prior_override=(np.vstack(rows), np.concatenate(target)),
            free_form_errors=self._curve_nuisances(prior),
        )
        x = (self.mean * scale)[:count]
        at = linearise(problem, x)
        if (near := update_instrument_poses(problem, at)) is not problem:
            problem, at = near, linearise(near, x)
        estimate = make_estimate(problem, nuisances(problem, at.reading_poses), at, "posterior",
                            len(mixture.children), self.linearised.linearisation_error)  # fmt: skip
        # Base parameters that could be wrong in place of the reported causes.
        far = () if self.alternative is None else self.alternative.warnings
        instead = [n.partition(":")[0] for n in far if n.kind == "tolerance"]
        told = [Note(f"these readings fit as well if {n}: measure it", "instead") for n in instead]
        return replace(
            estimate,
            covariance=self.covariance[:count, :count] * scale[:count] * scale[:count, None],
            weak=self.before.weak,
            warnings=(*estimate.warnings, *told),
        )

    def _curve_nuisances(self, prior: Array) -> NuisanceBlock | None:
        """Return columns of probable free-form errors, data faults and plate shapes, as nuisances.

        The mean is averaged over explanations, each of which has a different set of these.
        """
        linear, best = self.mixture.linear, {k for k, _ in self.mixture.best}
        likely = [k in best or p > LEAST_PROBABILITY for k, p in enumerate(self.mixture.inclusion)]
        each = zip(linear.groups, likely, strict=True)
        out = [g.coefficients for g, out in each if (g.free_form or g.of_data) and out]
        at = np.concatenate([*out, np.flatnonzero(linear.plate_shapes)]).astype(np.intp)
        if not len(at):
            return None
        sd = np.where(linear.plate_shapes, 1.0, np.sqrt(np.diag(prior)))[at]
        return NuisanceBlock(self.linearised.rows[:, at], sd)


def posterior_at_base_fit(before: Estimate) -> FullPosterior:
    """Return the posterior of the full model, linearised at the fit of the base."""
    return _posterior_at(before, (), suspected_faults=True)


def posterior_with_corrected_commands(before: Estimate) -> FullPosterior:
    """Return the posterior linearised at the base fit, with wrong commands corrected.

    The base is fitted again after each correction, until the corrections are stationary.
    """
    try:
        return _correct_commands(before)
    except ClosureError as error:
        raise SolverError(_closure_message(before)) from error


def _correct_commands(before: Estimate) -> FullPosterior:
    found, done = posterior_at_base_fit(before), dict[str, float]()
    for _ in range(_LINEARISATIONS):
        told = {s.name: s for s in found.active_faults if s.fault.commands}
        sizes = {name: found.sized_fault(one).size for name, one in told.items()}
        if sizes.keys() == done.keys() and all(
            abs(size - done[name]) < _COMMAND_CONVERGED for name, size in sizes.items()
        ):
            break
        done, wrong = sizes, [found.sized_fault(one) for one in told.values()]
        problem = with_commands_corrected(before.problem, wrong)
        fit = solve(problem, method="nested", widen=False) if wrong else before
        found = _posterior_at(fit, (), corrected=wrong, suspected_faults=True)
    return found


def full_posterior(
    before: Estimate,
    given: Sequence[str] = (),
    look: FullPosterior | None = None,
    unsure: Collection[FaultKey] = (),
) -> FullPosterior:
    """Return the posterior of the full model; the causes in ``given`` are active in any case.

    A base far beyond its tolerances may be biased by another cause. Both are therefore compared:
    the base with widened priors, and the full model with all priors at their tolerances.

    Args:
        before: the fit.
        given: names of declared causes.
        look: first posterior of the same fit, or of the fit at its tolerances.
        unsure: keys of the data faults that are searched for.

    Raises:
        SolverError: if the mean does not converge.
    """
    # Changes since a calibration, or between campaigns, never ask for a widened base.
    unknowns = before.problem.unknowns
    if before.problem.earlier_posterior is not None or any(u.name.campaign for u in unknowns):
        return _converge(before, given, look, unsure)
    at_tolerance = before.problem.with_prior_widths_reset()
    held = at_tolerance is before.problem
    try:
        narrow = before
        if not held:
            narrow = solve(at_tolerance, widen=False) if look is None else look.before
        other = _converge(narrow, given, look, unsure)
    except NumericsError:
        if held:
            raise
        return _converge(before, given, None, unsure)
    wide = widen_priors(before) if held else before
    if held and wide is before:
        return other
    unsettled = other.linearised.linearisation_error >= _CONVERGED
    try:
        found = _converge(wide, given, None, unsure)
    except SolverError:
        if unsettled and not held:
            raise
        return other
    if unsettled:
        # A wide base that needs further causes may have been biased by them.
        return other if held and found.mixture.best else found
    less = found.evidence - other.evidence
    if less > _DECISIVE_LOG_BAYES_FACTOR:
        return found
    return replace(other, alternative=wide if less > -_DECISIVE_LOG_BAYES_FACTOR else None)


def _converge(
    before: Estimate,
    given: Sequence[str],
    look: FullPosterior | None = None,
    unsure: Collection[FaultKey] = (),
) -> FullPosterior:
    """Return the posterior linearised at its mean, starting from ``look`` where it is given."""
    try:
        found = (
            look
            if look is not None and not given
            else _posterior_at(before, given, suspected_faults=unsure)
        )
        best = found
        for _ in range(_LINEARISATIONS - 1):
            if found.linearised.linearisation_error < _CONVERGED:
                break
            found = _posterior_at(before, given, found, suspected_faults=unsure)
            # Two explanations may alternate, each at the linearisation of the other.
            best = best_of((best, found), lambda one: -one.linearised.linearisation_error)
    except ClosureError as error:
        raise SolverError(_closure_message(before)) from error
    return best


def _posterior_at(
    before: Estimate,
    given: Sequence[str],
    last: FullPosterior | None = None,
    corrected: Sequence[Fault] = (),
    suspected_faults: bool | Collection[FaultKey] = False,
) -> FullPosterior:
    """Return the posterior, linearised at the base fit or at the mean of ``last``."""
    at, start = (None, ()) if last is None else (last.next_point, last.mixture.active_groups)
    about = linearise_full_model(before, at, corrected, suspected_faults)
    found = FullPosterior(before, about, Mixture(about.linear, given, start))
    return replace(
        found,
        linearised=replace(about, linearisation_error=about.linearisation_error_at(found.mean)),
    )


def _closure_message(before: Estimate) -> str:
    """Return the message that a machine does not close over its stroke: why, and what to do."""
    far = [note.partition(":")[0] for note in before.warnings if note.kind == "tolerance"]
    if not far:
        return (
            "the machine found does not close: the readings, or their units, are not those "
            "of this machine"
        )
    return (
        f"the machine found does not reach all of its stroke: {'; '.join(far)}: put these right "
        f"in the controller or on the machine, or give a shorter stroke in the machine file"
    )


def _inverse_root(covariance: Array) -> Array:
    """Return ``W`` with ``W^T W`` the inverse of a covariance ``(P, P)``."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1e-12 * values.max()))).T)
