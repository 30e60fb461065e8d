"""The readings as a linear model of every parameter, free-form error and data fault."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orthoglide.accuracy import workspace_grid
from orthoglide.effects import Effect
from orthoglide.effects.free_form import FreeForm
from orthoglide.explanation.candidates import build_groups, coefficient_spans
from orthoglide.explanation.compression import MOST_RANKED_READINGS, MergedRows, WhitenedReadings
from orthoglide.explanation.dial_curves import dial_curve_columns
from orthoglide.explanation.fault_columns import (
    FaultColumns,
    FaultKey,
    command_derivatives,
    fault_families,
)
from orthoglide.explanation.faults import Fault
from orthoglide.explanation.free_form import (
    free_form_columns,
    only_plate_readings,
    only_surface_readings,
    plate_shape_columns,
)
from orthoglide.explanation.linear_model import (
    RARE_LOG_PRIOR,
    SLAB_SCALES,
    Group,
    LinearModel,
    drop_unseen_directions,
    identity_group,
)
from orthoglide.explanation.screening import Screening
from orthoglide.explanation.twins import tool_slopes, translations, twins
from orthoglide.fit import Estimate, Problem, with_effects_freed
from orthoglide.fit.assembling import excited_effects
from orthoglide.fit.least_squares import (
    Linearised,
    Nuisances,
    fitted_basis,
    linearise,
    linearise_placed,
    nuisances,
    predict,
)
from orthoglide.fit.problem import MAX_TOLERANCES
from orthoglide.geometry import Array
from orthoglide.observations.arrays import equal_rows
from orthoglide.parameters import Parameter

_VAGUE_SD = 1e3
"""Tolerances: prior sd of a coefficient whose prior is given by rows of its own, to which it adds
a millionth of the information of one tolerance."""

_ZERO_SD = 1e-9
"""Tolerances: prior sd of what a twin represents, and of inactive jumps; it moves no reading."""

_LARGEST_SURFACE_BACKGROUND = 0.1
"""Tolerances: largest usual background if only a surface was measured. A wider one fits any surface
and excludes nothing. It is rare, and twice as rare if the surface is a plate of unknown shape."""

ENOUGH_REPEATS = 10
"""Repeats that determine the noise: on ten degrees of freedom, half or twice the noise has odds of
one to twenty."""


@dataclass(frozen=True, eq=False, repr=False)
class LinearisedModel:
    """The readings, linear in all coefficients, about one point."""

    problem: Problem  # all relevant parameters of the catalogue are free
    # SI of one unit of each coefficient (C,): parameters, free-form errors, plate shapes, then data
    # faults
    units: Array
    free_form_errors: tuple[FreeForm, ...]  # in the order of their coefficients
    linear: LinearModel  # for the mixture
    # by parameter: its twins, each with the value of the twin that is equivalent to 1 of the
    # parameter, both in SI; the columns of twins are zero
    twins: Mapping[str, tuple[tuple[str, float], ...]]
    translations: Array  # orthonormal directions that translate the machine (P, 3), tolerances
    rows: MergedRows  # readings by coefficient (n, C), metres or radians
    point: Array  # parameters at the linearisation (P,), SI
    value_at_zero: Array  # linear prediction, all coefficients zero (n,), metres or radians
    prior_rows: tuple[Array, Array]  # posterior of an earlier calibration: matrix and target
    # not in the base, excited by commands, load, temperature or time, and not replaced by a twin
    excited_parameters: tuple[Parameter, ...]
    unexplainable_chi2: float  # chi2 in the directions that no coefficient moves
    nuisance: Nuisances  # of the instruments, at the linearisation
    # rms difference of the prediction at the mean from its linearisation, sigmas
    linearisation_error: float = float("nan")
    screening: Screening | None = None  # of all data faults; absent after the search for them

    @property
    def parameter_count(self) -> int:
        """Number of the catalogue's parameters, whose coefficients come first."""
        return len(self.problem.unknowns)

    @property
    def log_constant(self) -> float:
        """Log likelihood that all explanations share: of what no coefficient moves, and of the
        noise, by which readings of other noise are compared.
        """
        return self.nuisance.log_density(self.problem.weighted) - self.unexplainable_chi2 / 2

    def with_hidden_faults(self, slab_root: Array) -> LinearisedModel | None:
        """Return the model with the data faults too that are likely beside active groups only;
        ``None`` if there are none, or not all faults are considered.

        Args:
            slab_root: of the active groups of the machine ``(C, k)``.
        """
        if self.screening is None or not slab_root.any():
            return None
        known = [group.source for group in self.linear.groups if group.of_data]
        names = {fault.name for fault in known}
        rows, linear = self.screening.rows, self.screening.linear
        count = linear.columns.shape[1]  # without data faults, which come last
        hidden = [f for f in self.screening.likeliest(slab_root[:count]) if f.name not in names]
        units = self.units[:count]
        without = replace(self, units=units, rows=rows, linear=linear, screening=None)
        return _with_data_faults(without, [*known, *hidden]) if hidden else None

    def at_mean(self, mean: Array, groups: Sequence[Group]) -> LinearisedModel:
        """Return the model with its linearisation error at a mean ``(C,)``.

        Of readings that are not ranked, the rows of free-form errors and data faults that are not
        among the groups are left out, which saves memory.
        """
        error = self._linearisation_error_at(mean)
        model = replace(self, linearisation_error=error, screening=None)
        if len(self.value_at_zero) <= MOST_RANKED_READINGS:
            return model
        kept = [np.arange(self.parameter_count), np.flatnonzero(self.linear.plate_shapes)]
        kept += [group.coefficients for group in groups]
        return replace(model, rows=self.rows.reduced_to(np.concatenate(kept)))

    def visible_part(self, coefficients: Any, values: Array) -> Array:
        """Return the readings ``(n,)`` that some coefficients predict, datums and all other
        nuisances of the instruments fitted.
        """
        readings = self.rows.columns(coefficients) @ values
        return np.asarray(readings - self.nuisance.explained_residual(readings))

    def _linearisation_error_at(self, mean: Array) -> float:
        """Return the rms difference, in sigmas, of the prediction at a mean ``(C,)`` from its
        linearisation.

        The errors of dials are evaluated at the readings predicted there, and in their order.
        """
        problem, count = self.problem, self.parameter_count
        predicted = predict(problem, (mean * self.units)[:count])
        linear = self.value_at_zero + self.rows.columns(slice(count)) @ mean[:count]
        columns, dial_errors = dial_curve_columns(problem, predicted, problem.measured - predicted)
        spans = coefficient_spans(self.free_form_errors, count)
        for error, current in zip(dial_errors, columns, strict=True):
            if error.name in spans:
                span = spans[error.name]
                predicted = predicted + (current - self.rows.columns(span)) @ mean[span]
        difference = self.nuisance.project(predicted - linear)
        return float(np.sqrt(np.mean(difference[: len(linear)] ** 2)))


def with_all_parameters(problem: Problem) -> Problem:
    """Return the problem with all parameters free that could move readings or the TCP."""
    excited = {effect.name for effect in excited_effects(problem)}

    def is_relevant(effect: Effect) -> bool:
        if "pitch" in effect.needs and problem.machine.spec.screw_pitch is None:
            return False
        of_used_dial = effect.of_dial and bool(problem.campaigns)
        return effect.at_rest or of_used_dial or effect.name in excited

    effects = [effect.name for effect in problem.machine.catalogue.effects if is_relevant(effect)]
    return with_effects_freed(problem, effects)


def linearise_full_model(
    estimate: Estimate,
    point: Array | None = None,
    corrected: Sequence[Fault] = (),
    suspected_faults: bool | Collection[FaultKey] = False,
) -> LinearisedModel:
    """Linearise the readings in all parameters, free-form errors and data faults.

    Args:
        estimate: a fit of the base model.
        point: parameters to linearise at ``(P,)``, SI; by default the fit, with all others zero.
        corrected: wrong commands that are corrected in the estimate's problem.
        suspected_faults: true to screen all data faults, or the keys of those to consider.
    """
    full_problem, linearised = _linearise_all_parameters(estimate, point)
    displacement = _displacement_by_commands(full_problem, linearised, corrected)
    model = _machine_model(estimate.problem, full_problem, linearised, displacement)
    if not suspected_faults:
        return _with_data_faults(model, ())
    families = fault_families(full_problem, linearised, corrected)
    if isinstance(suspected_faults, bool):
        residual = full_problem.measured - model.value_at_zero
        screening = Screening(
            families, full_problem, model.nuisance, model.rows, residual, model.linear
        )
        return _with_data_faults(replace(model, screening=screening), screening.likeliest())
    kinds = {kind for kind, *_ in suspected_faults}
    suspects = [suspect for family in families if family.kind in kinds
                for suspect in family if suspect.key(full_problem) in suspected_faults
                ]  # fmt: skip
    return _with_data_faults(model, suspects)


def _displacement_by_commands(
    full_problem: Problem, linearised: Linearised, corrected: Sequence[Fault]
) -> Array:
    """Return the displacement of the predicted readings by corrected commands ``(n,)``, metres or
    radians. It is added back to the residual, so that alternatives can compete for it.
    """
    displacement = np.zeros(len(linearised.value))
    if corrected:
        by_command = command_derivatives(full_problem, linearised.x, linearised.value, corrected)
        for fault in corrected:
            displacement[fault.rows] += by_command[fault.rows, fault.drive] * fault.size
    return displacement


def _machine_model(
    problem: Problem, full_problem: Problem, linearised: Linearised, displacement: Array
) -> LinearisedModel:
    """Return the linear model of the machine and its instruments, without data faults.

    Args:
        problem: with the base free.
        full_problem: with all parameters free.
        linearised: its readings, linearised.
        displacement: of the readings by corrected commands ``(n,)``, metres or radians.
    """
    nuisance = nuisances(full_problem, linearised.reading_poses)
    sd, x = full_problem.tolerance, linearised.x
    residual = problem.measured - linearised.value + displacement
    base_count = len(problem.unknowns)
    base = replace(linearised, jacobian=linearised.jacobian[:, :base_count])
    fitted = fitted_basis(problem, nuisance, base)[: len(residual)]
    rows, units, errors, plate_count = _scaled_columns(
        full_problem, linearised, residual, fitted, nuisance
    )
    value_at_zero = linearised.value - linearised.jacobian @ x - displacement
    fixed_sd, (matrix, target) = _fixed_priors(problem, len(units), errors, len(sd))
    prior_rows = np.pad(matrix, [(0, 0), (0, len(sd) - matrix.shape[1])]), target
    plate_shapes = np.arange(len(units)) >= len(units) - plate_count
    fixed_sd[plate_shapes] = 1.0
    readings = WhitenedReadings.of(problem, nuisance, rows, problem.measured - value_at_zero)
    slopes = tool_slopes(full_problem, x) * sd
    twin_parameters = twins(full_problem, base_count, readings.columns[:, : len(sd)], slopes)
    replaced = {other.plain for factors in twin_parameters.values() for other, _ in factors}
    replaced_index = np.flatnonzero([name.plain in replaced for name in full_problem.names])
    rows.blocks[0][0][:, replaced_index] = readings.columns[:, replaced_index] = 0.0
    fixed_sd[replaced_index] = _ZERO_SD
    readings = readings.with_prior_rows(prior_rows, units)
    replacements = {
        twin.plain.at(name.campaign): (name, 1 / factor)
        for name, factors in twin_parameters.items()
        for twin, factor in factors
    }
    groups, excited = build_groups(full_problem, base_count, readings.columns, errors, replacements)
    enough_repeats = problem.repeat_count >= ENOUGH_REPEATS
    linear = LinearModel(
        **vars(readings), fixed_sd=fixed_sd, free_form=np.arange(len(units)) >= len(sd),
        plate_shapes=plate_shapes, groups=groups,
        noise_weight=RARE_LOG_PRIOR if enough_repeats else 0.0,
        noise_decay=0.0 if enough_repeats else 1.0,
    )  # fmt: skip
    tolerance = full_problem.machine.tolerance
    twins_in_si: dict[str, tuple[tuple[str, float], ...]] = {
        name: tuple((twin, factor * tolerance(twin) / tolerance(name)) for twin, factor in factors)
        for name, factors in twin_parameters.items()
    }
    # On an even grid, over which a translation is the mean displacement.
    grid_slopes = tool_slopes(full_problem, x, workspace_grid(full_problem.machine.geometry)) * sd
    return LinearisedModel(
        full_problem, units, errors, _with_plate_priors(linear, problem),
        twins_in_si, translations(grid_slopes), rows, x, value_at_zero, prior_rows,
        tuple(name for name in excited if name.plain not in replaced), 0.0, nuisance,
    )  # fmt: skip


def _scaled_columns(
    full_problem: Problem,
    linearised: Linearised,
    residual: Array,
    fitted: Array,
    nuisance: Nuisances,
) -> tuple[MergedRows, Array, tuple[FreeForm, ...], int]:
    """Return all columns ``(n, C)``, their units, free-form errors and number of plate shapes."""
    sd, x, weighing = full_problem.tolerance, linearised.x, nuisance.weighing
    conditions = [
        np.column_stack([f.readings.sign, f.conditions().table[: len(f.measured)]])
        for f in full_problem.factors
    ]
    keys = weighing.station, weighing.sigma, weighing.common, nuisance.columns
    index = equal_rows(np.column_stack([*keys, np.vstack(conditions)]))
    first = np.unique(index, return_index=True)[1]
    machine_blocks, machine_errors = free_form_columns(full_problem, x, residual, fitted, first)
    dial_blocks, dial_errors = dial_curve_columns(full_problem, linearised.value, residual)
    plate_block, plate_sd = plate_shape_columns(full_problem)
    errors = (*machine_errors, *dial_errors)
    units = np.concatenate([sd, *(np.full(e.kernel.count, e.prior_sd) for e in errors), plate_sd])
    rows = MergedRows((), index).beside([linearised.jacobian * sd])
    rows = rows.beside(machine_blocks).beside([*dial_blocks, plate_block])
    return rows, units, errors, len(plate_sd)


def _with_data_faults(model: LinearisedModel, suspects: Sequence[FaultColumns]) -> LinearisedModel:
    """Return the model with a group for each data fault, in directions that a group can move."""
    if suspects:
        model = _with_fault_groups(model, suspects)
    compact, (_, target) = drop_unseen_directions(model.linear), model.prior_rows
    residual = model.nuisance.project(model.problem.measured - model.value_at_zero)
    chi2 = residual @ residual + target @ target - compact.residual @ compact.residual
    others = float(chi2 - compact.station_remainder.chi2)
    return replace(model, linear=compact, unexplainable_chi2=others)


def _with_fault_groups(model: LinearisedModel, suspects: Sequence[FaultColumns]) -> LinearisedModel:
    """Return the model with a group and columns for each data fault."""
    problem, linear = model.problem, model.linear
    residual = problem.measured - model.value_at_zero
    rows = model.rows.beside(s.full_columns(len(residual)) for s in suspects)
    units = np.concatenate([model.units, *(np.full(s.coefficient_count, s.unit) for s in suspects)])
    readings = WhitenedReadings.of(problem, model.nuisance, rows, residual)
    readings = readings.with_prior_rows(model.prior_rows, units)
    first, groups = len(model.units), list(linear.groups)
    for suspect in suspects:
        span = range(first, first := first + suspect.coefficient_count)
        prior = suspect.expected_count
        groups.append(identity_group(suspect.name, span, free_form=False, expected=prior,
                                     of_data=True, source=suspect))  # fmt: skip
    padding = (0, first - len(model.units))
    linear = replace(
        linear,
        **vars(readings),
        fixed_sd=np.pad(linear.fixed_sd, padding, constant_values=_ZERO_SD),
        free_form=np.pad(linear.free_form, padding),
        plate_shapes=np.pad(linear.plate_shapes, padding),
        groups=tuple(groups),
    )
    return replace(model, linear=linear, rows=rows, units=units)


def _linearise_all_parameters(
    estimate: Estimate, point: Array | None
) -> tuple[Problem, Linearised]:
    """Return the problem with all parameters free, and its readings linearised at ``point``.

    The frames of the instruments are those of the linearisation.
    """
    full_problem = with_all_parameters(estimate.problem)
    start = full_problem.zero_padded(estimate.x)
    x = start if point is None else point
    full_problem, linearised = linearise_placed(full_problem, x)
    if point is not None:
        # At the mean, a dial's scale error has a column proportional to the sum of displacements
        # found so far: it could replace all causes at once. Inactive dial effects use the base fit.
        of_dial = [full_problem.machine.catalogue.effect_of(n).of_dial for n in full_problem.names]
        inactive = np.array(of_dial) & (point == 0)
        linearised.jacobian[:, inactive] = linearise(full_problem, start).jacobian[:, inactive]
    return full_problem, linearised


def _with_plate_priors(linear: LinearModel, problem: Problem) -> LinearModel:
    """Return the model with the priors for readings of surfaces, or for plates with extra noise."""
    if only_surface_readings(problem):
        # Many causes fit one surface; only sizes that a machine may have are considered.
        slab_scales = tuple(s for s in SLAB_SCALES if s <= MAX_TOLERANCES)
        log_prior = 2 * RARE_LOG_PRIOR if only_plate_readings(problem) else RARE_LOG_PRIOR
        wide_background = _LARGEST_SURFACE_BACKGROUND, log_prior
        linear = replace(linear, slab_scales=slab_scales, wide_background=wide_background)
    if any(f.noise_capped.any() for f in problem.tool_factors):
        # Noise larger than declared was observed.
        linear = replace(linear, noise_weight=-RARE_LOG_PRIOR, noise_decay=0.0)
    return linear


def _fixed_priors(
    problem: Problem, count: int, errors: Sequence[FreeForm], first: int
) -> tuple[Array, tuple[Array, Array]]:
    """Return prior sd ``(C,)`` of coefficients without background scale, else nan, and prior rows.

    The prior sd of a base parameter is its prior width, in tolerances. Parameters of an earlier
    calibration have rows instead, matrix and target.
    """
    fixed_sd, spans = np.full(count, np.nan), coefficient_spans(errors, first)
    for error in errors:
        fixed_sd[spans[error.name]] = _ZERO_SD if error.only_if_active else np.nan
    fixed_sd[: len(problem.names)] = [u.prior_width for u in problem.unknowns]
    matrix, target, constrained = problem.correlated_prior_rows
    fixed_sd[: len(constrained)][constrained] = _VAGUE_SD
    return fixed_sd, (matrix, target)
