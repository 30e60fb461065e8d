"""The posterior of the full model: base parameters, effects, free-form errors and data faults.

The readings are linearised at the posterior mean, repeatedly until the mean is stationary.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.errors import NumericsError, SolverError
from orthoglide.explanation.alternatives import Alternatives
from orthoglide.explanation.base_fit import (
    closure_explained,
    exceeded_limits,
    fit_nested,
    fits_without_a_slip,
)
from orthoglide.explanation.columns import LinearisedModel, linearise_full_model
from orthoglide.explanation.corrections import with_exact_size, with_faults_corrected
from orthoglide.explanation.fault_columns import FaultKey
from orthoglide.explanation.faults import Fault
from orthoglide.explanation.linear_model import TWENTY_TO_ONE, Group
from orthoglide.explanation.mixture import LEAST_PROBABILITY, Mixture
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.factors import NuisanceBlock
from orthoglide.fit.least_squares import linearise_placed, nuisances
from orthoglide.fit.notes import tolerance_notes
from orthoglide.fit.problem import MAX_TOLERANCES
from orthoglide.fit.solving import make_estimate, solve, widen_priors
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.notes import Note
from orthoglide.ordering import best_of
from orthoglide.parameters import Parameter

_LINEARISATIONS = 3  # at most: 6 changed no result
_CONVERGED = 0.1
"""Root mean square, in sigmas of a reading, by which the prediction may still differ from its
linearisation: 0.01 of chi2 per reading, negligible for any cause."""

_NOT_LINEAR = 1.25
"""Root mean square, in sigmas, from which the linearisation is not valid: more than noise. Machines
off by all their tolerances reach 1.1; causes mistaken for a wrong command reach 1.3 and more."""

_COMMAND_CONVERGED = 2e-6
"""Metres: a smaller change of a wrong command's estimate, a tenth of the usual scatter of a dial,
counts as converged."""

_LEAST_PRIOR_VARIANCE = 1e-10
"""Squared tolerances: prior variance up to which a parameter is represented by its twin."""

_DETECTABLE_SIGMAS = 3.0
"""A parameter is invisible if the largest plausible error changes all readings by less."""


@dataclass(frozen=True, eq=False, repr=False)
class FullPosterior:
    """Posterior of the full model, given the readings."""

    before: Estimate  # the fit of the base model
    linearised: LinearisedModel  # the readings linearised at the mean
    mixture: Mixture  # of the explanations
    # alternative fit with the base far beyond its tolerances, which the readings do not rule out
    alternative: Estimate | None = None

    def of_equal_fit(self, fit: Estimate) -> FullPosterior | None:
        """Return the posterior of a fit that is equal, as readings and noise are, else ``None``."""
        own, other = ((f.problem.measured, f.problem.sigma, f.x) for f in (self.before, fit))
        return replace(self, before=fit) if all(map(np.array_equal, own, other)) else None

    @cached_property
    def alternatives(self) -> Alternatives:
        """Alternatives to the active groups of the best explanation."""
        return Alternatives(self.mixture)

    @property
    def mean(self) -> Array:
        """Posterior mean of all coefficients, in their units ``(C,)``."""
        return self.mixture.mean

    @property
    def evidence(self) -> float:
        """Log evidence of the best explanation, less the log factor of widened base priors."""
        log_widths = np.log([u.prior_width for u in self.before.problem.unknowns])
        log_weight = self.mixture.log_weight(self.mixture.best)
        return float(log_weight + self.linearised.log_constant - log_widths.sum())

    def data_fault(self, member: int, group: int) -> Fault:
        """Return the data fault of a group with its size, in the place of an active group."""
        data_group = self.mixture.linear.groups[group]
        mean = self.mixture.likeliest_mean(self.alternatives.state(member, group))
        fault: Fault = data_group.source.with_sizes(mean[data_group.coefficients])
        return fault

    def wrong_commands(self, written: Problem) -> dict[str, Fault]:
        """Return the wrong commands that the readings may have, by the names of their groups, given
        the problem with the commands as written.
        """
        x, possible = self.before.x, self.alternatives.possible_commands
        exact, groups = dict[str, Fault](), self.mixture.linear.groups
        for member, k in possible.items():
            fault, columns = self.data_fault(member, k), groups[k].source
            exact[groups[k].name] = with_exact_size(written, x, fault, columns.change(fault))
        return exact

    @property
    def next_point(self) -> Array:
        """Next point of linearisation ``(P,)``, SI: the mean, inactive dial effects at zero."""
        count = self.linearised.parameter_count
        effect_of = self.before.problem.machine.catalogue.effect_of
        of_dial = np.array([effect_of(n).of_dial for n in self.linearised.problem.names])
        for group, _ in self.mixture.best:
            coefficients = self.mixture.linear.groups[group].coefficients
            of_dial[coefficients[coefficients < count]] = False
        return np.where(of_dial, 0.0, (self.mean * self.linearised.units)[:count])

    @cached_property
    def averaged_covariances(self) -> tuple[Array, Array]:
        """Posterior and prior covariance averaged over all explanations ``(C, C)``, in units of the
        coefficients.
        """
        return self.mixture.averaged_covariances(self.linearised.parameter_count)

    @cached_property
    def covariance(self) -> Array:
        """Posterior covariance of all coefficients ``(C, C)``.

        Translations of the whole machine keep their full tolerances as prior, whatever the scale of
        the background.
        """
        count, translations = self.linearised.parameter_count, self.linearised.translations
        signatures = self.mixture.linear.columns[:, :count] @ translations
        precision = 1 / max(1 - min(self.background_scale, 1.0) ** 2, 1e-6)  # of the prior
        added = np.linalg.inv(precision * np.eye(translations.shape[1]) + signatures.T @ signatures)
        covariance = self.averaged_covariances[0].copy()
        covariance[:count, :count] += translations @ added @ translations.T
        steps = [group.coefficients for group in self.free_form_groups if group.source.is_step]
        for height, place in steps:  # its place between two stations is unknown
            covariance[place, place] = self.mean[height] ** 2 + covariance[height, height]
        return covariance

    @cached_property
    def _full_tolerance_variance(self) -> Array:
        """Variance ``(C,)`` of each shrunk coefficient under its full tolerance; 0 elsewhere.

        A small background scale is learned from visible coefficients and only assumed for invisible
        ones. A later visit with another sheet must not be tested against that assumption.
        """
        added, index = np.zeros(len(self.covariance)), np.arange(self.linearised.parameter_count)
        variance, spike = self.mixture.likeliest_variance(index)
        shrunk = (spike < 1.0) & (variance < spike) & (spike > _LEAST_PRIOR_VARIANCE)
        precision = 1 / variance[shrunk] - 1 / spike[shrunk] + 1.0
        added[index[shrunk]] = 1 / precision
        return added

    @property
    def converged(self) -> bool:
        """True if the linearisation is valid at the mean, which fits no worse than the base."""
        before, after = self.before.scores, self.after.scores
        # Few readings leave no degree of freedom: a chi2 difference below one is negligible.
        fits_no_worse = after.chi2 <= before.chi2 + max(after.dof, 1.0)
        return fits_no_worse and self.linearised.linearisation_error < _NOT_LINEAR

    @property
    def background_scale(self) -> float:
        """Posterior mean scale of inactive effects, in tolerances."""
        mixture = self.mixture
        return float(mixture.by_scale @ [s.background_scale for s in mixture.scales])

    @cached_property
    def invisible(self) -> tuple[Parameter, ...]:
        """Parameters beyond the base that these readings cannot detect at three tolerances.

        Their signature is too small, or is explained by the base, the instruments' nuisances or a
        plate's shape.
        """
        columns, model = self.mixture.scales[0].basis.columns, self.linearised
        names, catalogue = model.problem.names, model.problem.machine.catalogue

        def signal(name: Parameter) -> float:
            # A plate has one shape, however many setups probe it.
            of_plate, key = catalogue[name.effect].of_body, (name.effect, name.direction)
            copies = [k for k, n in enumerate(names)
                      if n == name or (of_plate and (n.effect, n.direction) == key)]  # fmt: skip
            return MAX_TOLERANCES * float(np.linalg.norm(columns[:, copies].sum(axis=1)))

        return tuple(n for n in model.excited_parameters if signal(n) < _DETECTABLE_SIGMAS)

    @cached_property
    def free_form_groups(self) -> tuple[Group, ...]:
        """Groups of the free-form errors probable enough to enter the calibrated machine."""
        groups = zip(self.mixture.linear.groups, self.mixture.inclusion, strict=True)
        probable = (g for g, p in groups if p > LEAST_PROBABILITY and g.free_form)
        return tuple(group for group in probable if group.source.of_machine)

    @cached_property
    def machine_weights(self) -> tuple[tuple[str, ...], Array]:
        """Parameters of the last campaign's machine, and their weights by coefficient, SI."""
        problem, units = self.linearised.problem, self.linearised.units
        names, matrix = problem.machine_parameters(problem.last_factor_index)
        blocks = [np.pad(matrix, [(0, 0), (0, len(units) - matrix.shape[1])])]
        for group in self.free_form_groups:
            blocks.append(np.arange(len(units)) == group.coefficients[:, None])
            names = (*names, *group.source.effect.motions)
        return tuple(names), np.vstack(blocks) * units

    def machine_values(self, mean: Array) -> dict[str, float]:
        """Return the parameters of the last campaign's machine at a mean ``(C,)``, SI."""
        names, weights = self.machine_weights
        return dict(zip(names, (weights @ mean).tolist(), strict=True))

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine: posterior mean and covariance."""
        machine = self.before.problem.machine
        effects = (group.source.effect for group in self.free_form_groups)
        machine = machine.with_effects(e for e in effects if e.name not in machine.catalogue)
        names, weights = self.machine_weights
        covariance = weights @ self.covariance @ weights.T
        at_full_tolerance = weights**2 @ self._full_tolerance_variance
        posterior = Posterior(names, weights @ self.mean, covariance, at_full_tolerance)
        return machine.with_posterior(self.machine_values(self.mean), posterior)

    @cached_property
    def after(self) -> Estimate:
        """Estimate at the posterior mean, scored, with the learned prior in place of tolerances."""
        linearised, mixture, prior = self.linearised, self.mixture, self.averaged_covariances[1]
        count, units = linearised.parameter_count, linearised.units
        values, vectors = np.linalg.eigh(prior[:count, :count])
        sd = np.sqrt(np.maximum(values, 1e-12 * values.max()))  # of rounding at least
        prior_root = (vectors / sd).T / units[:count]  # of the inverse
        matrix, target = linearised.prior_rows  # empty without an earlier calibration
        prior_rows = np.vstack([prior_root, matrix]), np.concatenate([np.zeros(count), target])
        curves = self._curve_nuisances(prior)
        problem = replace(linearised.problem, prior_override=prior_rows, free_form_nuisances=curves)
        problem, fit = linearise_placed(problem, (self.mean * units)[:count])
        estimate = make_estimate(problem, nuisances(problem, fit.reading_poses), fit, "posterior",
                                 len(mixture.children), linearised.linearisation_error)  # fmt: skip
        # Base parameters that could be wrong in place of the reported causes.
        instead = [] if self.alternative is None else exceeded_limits(self.alternative)
        text = "these readings fit as well if {}: measure it"
        notes = [Note(text.format(clause), "instead") for clause in instead]
        covariance = self.covariance[:count, :count] * units[:count] * units[:count, None]
        estimate = replace(estimate, covariance=covariance, weak=self.before.weak)
        warnings = (*estimate.warnings, *tolerance_notes(estimate), *notes)
        return replace(estimate, warnings=warnings)

    def _curve_nuisances(self, prior: Array) -> NuisanceBlock | None:
        """Return columns of probable free-form errors, data faults and plate shapes, as nuisances.

        The mean is averaged over explanations, each of which has a different set of these.
        """
        linear, groups = self.mixture.linear, self.mixture.likely_groups
        spans = [group.coefficients for group in groups if group.free_form or group.of_data]
        coefficients = np.concatenate([*spans, np.flatnonzero(linear.plate_shapes)]).astype(np.intp)
        if not len(coefficients):
            return None
        sd = np.where(linear.plate_shapes, 1.0, np.sqrt(np.diag(prior)))[coefficients]
        return NuisanceBlock(self.linearised.rows.columns(coefficients), sd)


def posterior_at_base_fit(before: Estimate) -> FullPosterior:
    """Return the posterior of the full model, linearised at the fit of the base, or of all readings
    but one if the linearisation is then better.
    """
    posterior = _posterior_at(before, (), suspected_faults=True)
    if posterior.linearised.linearisation_error < _NOT_LINEAR:
        return posterior
    starts = fits_without_a_slip(before, posterior.mixture)
    others = [_posterior_at(start, (), suspected_faults=True) for start in starts]
    return best_of((posterior, *others), lambda p: -p.linearised.linearisation_error)


def posterior_with_corrected_commands(
    before: Estimate, known: FullPosterior | None = None
) -> FullPosterior:
    """Return the posterior linearised at the base fit, with wrong commands corrected.

    The base is fitted again after each correction, until the corrections are stationary. What is
    ``known`` at a base fit is not computed again if it is of equal readings.
    """
    corrected = dict[str, Fault]()
    with closure_explained(before):
        posterior = (known and known.of_equal_fit(before)) or posterior_at_base_fit(before)
        for _ in range(_LINEARISATIONS):
            wrong = posterior.wrong_commands(before.problem)
            if wrong.keys() == corrected.keys() and all(
                abs(wrong[name].size - corrected[name].size) < _COMMAND_CONVERGED for name in wrong
            ):
                break
            corrected = wrong
            problem = with_faults_corrected(before.problem, [*wrong.values()])
            fit = fit_nested(problem) if wrong else before
            posterior = _posterior_at(fit, (), posterior, [*wrong.values()], suspected_faults=True)
    return posterior


def full_posterior(
    before: Estimate,
    given: Sequence[str] = (),
    first_posterior: FullPosterior | None = None,
    fault_keys: Collection[FaultKey] = (),
) -> FullPosterior:
    """Return the posterior of the full model; the causes in ``given`` are active in any case.

    A base far beyond its tolerances may be biased by another cause. Both are therefore compared:
    the base with widened priors, and the full model with all priors at their tolerances.

    Args:
        before: the fit.
        given: names of declared causes.
        first_posterior: of the same fit, or of the fit at its tolerances.
        fault_keys: of the data faults that are searched for.

    Raises:
        SolverError: if the mean does not converge.
    """
    # Changes since a calibration, or between campaigns, are never fitted by a widened base.
    unknowns = before.problem.unknowns
    if before.problem.earlier_posterior is not None or any(u.name.campaign for u in unknowns):
        return _converge(before, given, first_posterior, fault_keys)
    narrow_problem = before.problem.with_prior_widths_reset()
    already_narrow = narrow_problem is before.problem
    try:
        if first_posterior is not None:
            narrow_fit = first_posterior.before
        else:
            narrow_fit = before if already_narrow else solve(narrow_problem, widen=False)
        narrow = _converge(narrow_fit, given, first_posterior, fault_keys)
    except NumericsError:
        if already_narrow:
            raise
        return _converge(before, given, None, fault_keys)
    wide_fit = widen_priors(before) if already_narrow else before
    if already_narrow and wide_fit is before:
        return narrow
    not_converged = narrow.linearised.linearisation_error >= _CONVERGED
    try:
        wide = _converge(wide_fit, given, narrow, fault_keys)
    except SolverError:
        if not_converged and not already_narrow:
            raise
        return narrow
    if not_converged:
        # A wide base that needs further causes may have been biased by them.
        return narrow if already_narrow and wide.mixture.best else wide
    log_bayes_factor = wide.evidence - narrow.evidence
    # A part far beyond its tolerance is as improbable beforehand as any other cause.
    prior_log_odds_against = wide.before.problem.widened_parts * wide.mixture.cause_cost
    if log_bayes_factor > max(TWENTY_TO_ONE, prior_log_odds_against):
        return wide
    undecided = log_bayes_factor > -TWENTY_TO_ONE
    return replace(narrow, alternative=wide_fit if undecided else None)


def _converge(
    before: Estimate,
    given: Sequence[str],
    previous: FullPosterior | None = None,
    fault_keys: Collection[FaultKey] = (),
) -> FullPosterior:
    """Return the posterior linearised at its mean, from ``previous``, or from its active groups if
    it is of another fit or causes are given.
    """
    with closure_explained(before):
        usable = previous is not None and previous.before is before and not given
        first = previous if usable else None
        best = posterior = first or _posterior_at(before, given, previous, (), fault_keys)
        for _ in range(_LINEARISATIONS - 1):
            if posterior.linearised.linearisation_error < _CONVERGED:
                break
            posterior = _posterior_at(before, given, posterior, suspected_faults=fault_keys)
            # Two explanations may alternate, each at the linearisation of the other.
            best = best_of((best, posterior), lambda p: -p.linearised.linearisation_error)
    return best


def _posterior_at(
    before: Estimate,
    given: Sequence[str],
    previous: FullPosterior | None = None,
    corrected: Sequence[Fault] = (),
    suspected_faults: bool | Collection[FaultKey] = False,
) -> FullPosterior:
    """Return the posterior, linearised at the base fit, or at the mean of ``previous`` if of the
    same fit; the search starts from the active groups of ``previous``.
    """
    point = previous.next_point if previous and previous.before is before else None
    start = () if previous is None else previous.mixture.active_groups
    linearised = linearise_full_model(before, point, corrected, suspected_faults)
    mixture = Mixture(linearised.linear, given, start)
    if more := linearised.with_hidden_faults(mixture.machine_slab_root):
        linearised, mixture = more, Mixture(more.linear, given, mixture.active_groups)
    return FullPosterior(before, linearised.at_mean(mixture.mean, mixture.likely_groups), mixture)
