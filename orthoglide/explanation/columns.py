"""The readings about a machine, linear in everything that could be wrong with it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from orthoglide.accuracy import workspace_grid
from orthoglide.effects import Effect
from orthoglide.effects.free_form import FreeForm
from orthoglide.explanation.candidates import Candidate
from orthoglide.explanation.compression import (
    COMPRESSION_THRESHOLD,
    StationRemainder,
    compress_readings,
)
from orthoglide.explanation.fault_columns import (
    FaultColumns,
    FaultKey,
    command_derivatives,
    fault_columns,
)
from orthoglide.explanation.faults import Fault
from orthoglide.explanation.free_form import (
    dial_curve_columns,
    free_form_columns,
    only_plate_readings,
    only_surface_readings,
    plate_shape_columns,
)
from orthoglide.explanation.grouping import build_groups, coefficient_spans
from orthoglide.explanation.linear_model import (
    RARE_LOG_PRIOR,
    SLAB_SCALES,
    LinearModel,
    drop_unseen_directions,
    identity_group,
)
from orthoglide.explanation.screening import screen_data_faults
from orthoglide.explanation.twins import tool_slopes, translations, twins
from orthoglide.fit import Estimate, Problem, with_effects_freed
from orthoglide.fit.excitation import excited_effects
from orthoglide.fit.least_squares import (
    Linearised,
    Nuisances,
    linearise,
    nuisances,
    predict,
    update_instrument_poses,
)
from orthoglide.fit.unknowns import posterior_rows
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter

_VAGUE_SD = 1e3
"""Tolerances: the prior of a coefficient that rows of its own speak of."""

_ZERO_SD = 1e-9  # tolerances: prior of a coefficient for which another stands

_LARGEST_SURFACE_BACKGROUND = 0.1
"""Largest background to expect, in tolerances, where a surface is all that was read: a wider one
draws any surface, and names nothing. It is rare where distances tell of the machine as well; where
plates alone do, which have shapes of their own, twice as rare."""

_LARGEST_SURFACE_SLAB = 3.0
"""Largest scale, in tolerances, of what stands out of it: among the many causes that draw one
surface those count that a machine may have."""

_ENOUGH_REPEATS = 10
"""Repeats from which they show the noise: half of it, or twice, has odds of twenty to one against
it on ten degrees of freedom."""

_SCREENING_BACKGROUNDS = (0.003, 0.1, 1.0)
"""Tolerances of backgrounds of which each may hide a fault of the data, or make one up."""


@dataclass(frozen=True, eq=False, repr=False)
class LinearisedModel:
    """All that could be wrong, with what the readings say of it about one point."""

    problem: Problem  # with every parameter of the catalogue that could matter free
    # SI of one unit of each coefficient (C,): the parameters, then the places', then those of the
    # plates' own shapes
    units: Array
    free_form_errors: tuple[
        FreeForm, ...
    ]  # with their coefficients behind the parameters, in order
    # causes that the readings could show, in the order of the linear groups
    candidates: tuple[Candidate, ...]
    linear: LinearModel  # for the mixture
    # of a parameter, others of the same readings and the same tool, each with the value that stands
    # for one of it; these have no coefficient
    twins: Mapping[str, tuple[tuple[str, float], ...]]
    # orthonormal directions of the parameters that move the machine as a whole (P, 3), in
    # tolerances
    translations: Array
    rows: Array  # readings by coefficient (n, C), metres
    point: Array  # parameters where they are linearised (P,), SI
    value_at_zero: Array  # readings where everything is zero, as linearised (n,), metres
    # what an earlier calibration says of the parameters: matrix and target
    prior_rows: tuple[Array, Array]
    varied_parameters: tuple[
        Parameter, ...
    ]  # parameters beyond the base whose conditions the readings vary
    # faults of the data that could stand out, in the order of the last linear groups
    suspects: tuple[FaultColumns, ...]
    unexplainable_chi2: float  # square of what the readings have where nothing could show
    nuisance: Nuisances  # of the instruments, where the readings are linearised
    linearisation_error: float = float(
        "nan"
    )  # of the prediction from its linearisation at the mean, sigmas

    @property
    def parameter_count(self) -> int:
        """Number of the catalogue's coefficients, which come first."""
        return len(self.problem.unknowns)

    def coefficients(self, place: FreeForm) -> NDArray[np.intp]:
        """Where a place's coefficients stand."""
        return coefficient_spans(self.free_form_errors, self.parameter_count)[place.name]

    def linearisation_error_at(self, mean: Array) -> float:
        """Root mean square, in sigmas, of the prediction at a mean ``(C,)`` past its
        linearisation; what dials do goes by the readings that are predicted, and by their order.
        """
        predicted = predict(self.problem, (mean * self.units)[: self.parameter_count])
        linear = (
            self.value_at_zero + self.rows[:, : self.parameter_count] @ mean[: self.parameter_count]
        )
        columns, dials = dial_curve_columns(
            self.problem, predicted, self.problem.measured - predicted
        )
        own = coefficient_spans(self.free_form_errors, self.parameter_count)
        for place, block in zip(dials, columns, strict=True):
            if place.name in own:
                at = own[place.name]
                predicted = predicted + (block - self.rows[:, at]) @ mean[at]
        off = self.nuisance.project(predicted - linear)
        return float(np.sqrt(np.mean(off[: len(linear)] ** 2)))


def with_all_parameters(problem: Problem) -> Problem:
    """All other parameters of the catalogue freed, seen or not, that could move readings or TCP."""
    excited = {effect.name for effect in excited_effects(problem)}

    def counts(effect: Effect) -> bool:
        if "pitch" in effect.needs and problem.machine.spec.screw_pitch is None:
            return False
        at_hand = effect.at_rest or (effect.of_dial and bool(problem.campaigns))
        return at_hand or effect.name in excited

    effects = [effect.name for effect in problem.machine.catalogue.effects if counts(effect)]
    return with_effects_freed(problem, effects)


def linearise_full_model(
    estimate: Estimate,
    at: Array | None = None,
    corrected: Sequence[Fault] = (),
    suspected_faults: bool | Collection[FaultKey] = False,
) -> LinearisedModel:
    """Linearise the readings by everything that could be wrong.

    Args:
        estimate: a fit of the base; gives the problem and its nuisances.
        at: parameters to linearise at ``(P,)``, SI; the fit's, others zero, where absent.
        corrected: wrong commands that are put right in the estimate's problem, and weighed.
        suspected_faults: whether the data may have faults, or which.
    """
    wide, _, here = _linearise_all_parameters(estimate, at)
    about = _machine_model(
        estimate.problem, wide, here, _displacement_by_commands(wide, here, corrected)
    )
    if suspected_faults:
        several = fault_columns(wide, here, corrected)
        if not isinstance(suspected_faults, bool):
            several = [s for s in several if s.key(wide) in suspected_faults]
        about = _with_data_faults(about, several, corrected, suspected_faults is True)
    linear, kept = about.linear, drop_unseen_directions(about.linear)
    outside = float(linear.residual @ linear.residual - kept.residual @ kept.residual)
    return replace(about, linear=kept, unexplainable_chi2=outside)


def _displacement_by_commands(wide: Problem, here: Linearised, corrected: Sequence[Fault]) -> Array:
    """Return by how much corrected commands moved the predicted readings ``(n,)``, metres: what
    other explanations of them have to explain.
    """
    moved = np.zeros(len(here.value))
    if corrected:
        by_command = command_derivatives(wide, here.x, here.value)
        for fault in corrected:
            drive, size = fault.commands[0]
            moved[fault.rows] += by_command[fault.rows, drive] * size
    return moved


def _machine_model(
    problem: Problem, wide: Problem, here: Linearised, moved: Array
) -> LinearisedModel:
    """The readings, linear in everything that could be wrong with the machine and its instruments.

    Args:
        problem: with the base free.
        wide: with everything free.
        here: where this is linearised.
        moved: by how much corrected commands moved the readings there ``(n,)``, metres.
    """
    nuisance, sd, x = nuisances(wide, here.reading_poses), wide.tolerance, here.x
    off = problem.measured - here.value + moved
    free_rows, found = free_form_columns(wide, x, off - nuisance.explained_residual(off))
    of_dials, dials = dial_curve_columns(wide, here.value, off)
    of_plates, sizes = plate_shape_columns(wide)
    blocks = chain(free_rows, of_dials, [of_plates])
    found = (*found, *dials)
    scale = np.concatenate([sd, *(np.full(p.kernel.count, p.prior_sd) for p in found), sizes])
    rows = np.empty((len(off), len(scale)))
    np.multiply(here.jacobian, sd, out=rows[:, : len(sd)])
    first = len(sd)
    for block in blocks:
        rows[:, first : (first := first + block.shape[1])] = block
    value = here.value - here.jacobian @ x
    fixed, known = _fixed_priors(problem, len(scale))
    unnamed = np.arange(len(scale)) >= len(scale) - len(sizes)
    fixed[unnamed] = 1.0
    readings = _WhitenedReadings.of(problem, nuisance, rows, problem.measured - value)
    free, slopes = len(problem.unknowns), tool_slopes(wide, x) * sd
    same = twins(wide, free, readings.columns[:, : len(sd)], slopes)
    gone = {other.plain for others in same.values() for other, _ in others}
    stood_for = np.flatnonzero([n.plain in gone for n in wide.names])
    rows[:, stood_for] = readings.columns[:, stood_for] = 0.0
    fixed[stood_for] = _ZERO_SD
    known = np.pad(known[0], [(0, 0), (0, len(sd) - known[0].shape[1])]), known[1]
    readings = readings.with_prior_rows(known, scale)
    stands = {o.plain.at(n.campaign): (n, 1 / f) for n, others in same.items() for o, f in others}
    groups, causes, asked = build_groups(wide, free, readings.columns, found, stands)
    is_free = np.arange(len(scale)) >= len(sd)
    repeats = problem.repeat_count >= _ENOUGH_REPEATS
    linear = LinearModel(
        readings.columns, readings.residual, fixed, is_free, unnamed, groups, readings.stations,
        noise_weight=RARE_LOG_PRIOR if repeats else 0.0, noise_decay=0.0 if repeats else 1.0,
        station_remainder=readings.station_remainder,
    )  # fmt: skip
    tolerance = wide.machine.tolerance
    by_name: dict[str, tuple[tuple[str, float], ...]] = {
        n: tuple((o, f * tolerance(o) / tolerance(n)) for o, f in others)
        for n, others in same.items()
    }
    # On even commands, where the place of the whole is what all of them share.
    even = tool_slopes(wide, x, workspace_grid(wide.machine.geometry)) * sd
    return LinearisedModel(
        wide, scale, found, causes, _with_plate_priors(linear, problem), by_name, translations(even),
        rows, x, value, known, tuple(n for n in asked if n.plain not in gone), (), 0.0, nuisance,
    )  # fmt: skip


def _with_data_faults(
    about: LinearisedModel,
    several: Sequence[FaultColumns],
    corrected: Sequence[Fault],
    screen: bool,
) -> LinearisedModel:
    """The same with faults of the data, each a group: those that could stand out where they are to
    be screened, and those of commands that are put right where this is linearised.
    """
    problem, linear = about.problem, about.linear
    right = {s.name: s for s in several if any(s.fault is f for f in corrected)}
    # The alternatives to a corrected command have to explain what it explains.
    value = about.value_at_zero.copy()
    for one in right.values():
        value[one.fault.rows] -= one.columns[:, 0] * one.fault.size / one.unit
    rest = problem.measured - value
    kept = [*several]
    if screen:
        backgrounds = [np.sqrt(linear.spike(share, share)) for share in _SCREENING_BACKGROUNDS]
        readings = _WhitenedReadings.of(problem, about.nuisance, about.rows, rest)
        readings = readings.with_prior_rows(about.prior_rows, about.units)
        compact = readings.columns, readings.residual
        kept = screen_data_faults(
            several, problem, about.nuisance, about.rows, rest, compact, backgrounds, right
        )
    if not kept:
        return about
    rows = np.hstack([about.rows, *(s.full_columns(len(value)) for s in kept)])
    scale = np.concatenate([about.units, *(np.full(s.coefficient_count, s.unit) for s in kept)])
    readings = _WhitenedReadings.of(problem, about.nuisance, rows, rest)
    readings = readings.with_prior_rows(about.prior_rows, scale)
    first, groups = len(about.units), list(linear.groups)
    for one in kept:
        group = identity_group(
            one.name, range(first, first + one.coefficient_count), free_form=False
        )
        groups.append(replace(group, expected=one.expected_count, of_data=True))
        first += one.coefficient_count
    more = (0, first - len(about.units))
    linear = replace(
        linear,
        columns=readings.columns,
        residual=readings.residual,
        stations=readings.stations,
        station_remainder=readings.station_remainder,
        fixed_sd=np.pad(linear.fixed_sd, more, constant_values=_ZERO_SD),
        free_form=np.pad(linear.free_form, more),
        plate_shapes=np.pad(linear.plate_shapes, more),
        groups=tuple(groups),
    )
    return replace(
        about, linear=linear, rows=rows, units=scale, value_at_zero=value, suspects=tuple(kept)
    )


@dataclass(frozen=True, eq=False, repr=False)
class _WhitenedReadings:
    """Readings in units of their noise, past the nuisances of the instruments."""

    columns: Array  # by coefficient (m, C)
    residual: Array  # what they are to explain (m,)
    stations: Array  # an error of one sigma at each station (m, s)
    station_remainder: StationRemainder

    @classmethod
    def of(
        cls, problem: Problem, nuisance: Nuisances, rows: Array, rest: Array
    ) -> _WhitenedReadings:
        """Of rows ``(n, C)`` and what these are to explain ``(n,)``."""
        if len(rest) > COMPRESSION_THRESHOLD:
            return cls(*compress_readings(nuisance, rows, rest))
        each = np.eye(int(problem.station.max()) + 1)[problem.station] * problem.sigma[:, None]
        project = nuisance.project
        return cls(project(rows), project(rest), project(each), (0.0, 0.0, 1.0))

    def with_prior_rows(self, known: tuple[Array, Array], scale: Array) -> _WhitenedReadings:
        """The same with rows of what was known before ``(k, P)``, by coefficients of some scale."""
        matrix, target = known
        matrix = np.pad(matrix, [(0, 0), (0, len(scale) - matrix.shape[1])]) * scale
        none = np.zeros((len(target), self.stations.shape[1]))
        return replace(
            self,
            columns=np.vstack([self.columns, matrix]),
            residual=np.concatenate([self.residual, target]),
            stations=np.vstack([self.stations, none]),
        )


def _linearise_all_parameters(
    estimate: Estimate, at: Array | None
) -> tuple[Problem, Array, Linearised]:
    """Everything about a machine that has the instruments' frames where it is linearised, that
    place ``(P,)``, SI, and the readings there.
    """
    wide = with_all_parameters(estimate.problem)
    start = wide.zero_padded(estimate.x)
    x = start if at is None else at
    here = linearise(wide, x)
    if (near := update_instrument_poses(wide, here)) is not wide:
        wide, here = near, linearise(near, x)
    if at is None:
        return wide, x, here
    # A dial that magnifies everything found so far would be one coefficient in place of many: what
    # a dial does that does not stand out is taken at the base fit, where it cannot stand in for the
    # machine.
    of_dial = [wide.machine.catalogue.effect_of(n).of_dial for n in wide.names]
    resting = np.array(of_dial) & (at == 0)
    here.jacobian[:, resting] = linearise(wide, start).jacobian[:, resting]
    return wide, x, here


def _with_plate_priors(linear: LinearModel, problem: Problem) -> LinearModel:
    """The same where a surface is all that was read, or plates have errors without structure."""
    if only_surface_readings(problem):
        likely = tuple(s for s in SLAB_SCALES if s <= _LARGEST_SURFACE_SLAB)
        rare = 2 * RARE_LOG_PRIOR if only_plate_readings(problem) else RARE_LOG_PRIOR
        linear = replace(
            linear, slab_scales=likely, wide_background=(_LARGEST_SURFACE_BACKGROUND, rare)
        )
    if any(f.noise_capped.any() for f in problem.tool_factors):
        linear = replace(
            linear, noise_weight=-RARE_LOG_PRIOR, noise_decay=0.0
        )  # these have been seen
    return linear


def _fixed_priors(problem: Problem, count: int) -> tuple[Array, tuple[Array, Array]]:
    """Prior sd of what no background has ``(C,)``, nan elsewhere; rows of what was known before.

    What was free before stands at its tolerance. What an earlier calibration speaks of has rows
    instead.
    """
    fixed = np.full(count, np.nan)
    fixed[: len(problem.names)] = [u.prior_width for u in problem.unknowns]
    if problem.earlier_posterior is None:
        return fixed, (np.zeros((0, len(problem.names))), np.zeros(0))
    matrix, target, spoken = posterior_rows(problem.earlier_posterior, problem.unknowns)
    fixed[: len(spoken)][spoken] = _VAGUE_SD
    return fixed, (matrix, target)
