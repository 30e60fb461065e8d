"""Problem of an identification: its unknowns, and the factors whose sum is minimised."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.fit.factors import Factor, NuisanceBlock
from orthoglide.fit.noise import Noise, Weighing, rms_by_unit
from orthoglide.fit.repeats import MIN_REPEAT_DOF, repeat_variance
from orthoglide.fit.unknowns import Unknown, posterior_rows, shared_error_rows, weight_matrix
from orthoglide.geometry import Array
from orthoglide.instruments import OBSERVATIONS
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.numerals import ByUnit
from orthoglide.observations import Readings, Setup
from orthoglide.parameters import Parameter
from orthoglide.result.fits import InstrumentNoise

MAX_TOLERANCES = 3.0
"""Tolerances beyond which a parameter is implausible: of a machine as expected, one in 370 is."""

CERTAIN_SIGMAS = 2.0
"""Standard deviations by which a parameter must exceed that limit to be reported: one in forty
that do not exceed it does so by chance."""


@dataclass(frozen=True, repr=False)
class Problem:
    """An identification, ready to be solved by any of the methods.

    The objective is a sum of squares: residuals of all factors, plus priors from tolerances, plus
    the posterior of an earlier calibration.
    """

    machine: Machine  # nominal dimensions, tolerances, and the parameters that are held
    factors: tuple[Factor, ...]  # tables of readings: on legs first, then at the tool
    unknowns: tuple[Unknown, ...]  # the `P` free parameters
    noise: Noise  # of the readings in one figure
    use_tolerance_priors: bool  # whether tolerances act as priors about zero
    held: tuple[Mapping[str, float], ...]  # for each factor, parameters that are not free, SI
    # effects and parameters, free or not, with a value for each campaign; with `@` and a file's
    # stem, with another value from that campaign on
    per_campaign: tuple[str, ...] = ()
    earlier_posterior: Posterior | None = None  # of an earlier calibration
    # rows and target `|W x - t|^2` that replace the tolerances and the earlier posterior
    prior_override: tuple[Array, Array] | None = None
    # significant errors that no parameter describes: free functions, as nuisances
    free_form_nuisances: NuisanceBlock | None = None

    @cached_property
    def leg_factors(self) -> tuple[Factor, ...]:
        """Readings of legs, which come first."""
        return tuple(f for f in self.factors if f.on_legs)

    @property
    def tool_factors(self) -> tuple[Factor, ...]:
        """Readings of the tool."""
        return self.factors[len(self.leg_factors) :]

    @property
    def campaigns(self) -> tuple[Readings, ...]:
        """Tables of the readings of legs."""
        return tuple(f.readings for f in self.leg_factors)

    @property
    def has_earlier_calibration(self) -> bool:
        """Whether an earlier calibration is known, from which the machine may have changed."""
        return self.earlier_posterior is not None and self.machine.spec.is_calibrated

    def with_leg_factors(self, leg_factors: Sequence[Factor]) -> Problem:
        """Return the problem with its tables of readings on legs replaced by as many others."""
        return replace(self, factors=(*leg_factors, *self.tool_factors))

    def zero_padded(self, x: Array) -> Array:
        """Return unknowns ``x`` of a problem that this one extends, with zeros for the others."""
        return np.pad(x, (0, len(self.unknowns) - len(x)))

    def iter_tool_setups(self) -> Iterator[tuple[int, Factor, int, Setup]]:
        """Yield factor index, factor, setup index within the factor, and setup, for each setup at
        the tool.
        """
        first = len(self.leg_factors)
        for k, factor in enumerate(self.tool_factors, first):
            for number, setup in enumerate(factor.readings.setups):
                yield k, factor, number, setup

    @property
    def names(self) -> tuple[Parameter, ...]:
        """Names of the unknowns."""
        return tuple(u.name for u in self.unknowns)

    @cached_property
    def factor_rows(self) -> tuple[slice, ...]:
        """Slice of each factor in the stacked rows."""
        ends = np.cumsum([0, *(len(f.measured) for f in self.factors)]).tolist()
        return tuple(slice(first, end) for first, end in pairwise(ends))

    @property
    def leg_rows(self) -> tuple[slice, ...]:
        """Slice of each table of readings on legs in the stacked rows."""
        return self.factor_rows[: len(self.leg_factors)]

    @cached_property
    def measured(self) -> Array:
        """Readings of all factors ``(n,)``, metres or radians."""
        return np.concatenate([f.measured for f in self.factors])

    @cached_property
    def angular(self) -> NDArray[np.bool_]:
        """Which rows are inclinations, radians ``(n,)``; all others are lengths, metres."""
        return self.column("angular")

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of all rows ``(n,)``, metres or radians."""
        return np.concatenate([f.noise.sigma for f in self.factors])

    @cached_property
    def shared_rounding_sd(self) -> Array:
        """Standard deviation of the rounding error that all visits to a station share ``(n,)``,
        metres or radians.
        """
        return np.concatenate([f.noise.common for f in self.factors])

    @cached_property
    def reading_sd(self) -> Array:
        """Standard deviation of each reading, its rounding counted ``(n,)``, metres or radians."""
        return np.hypot(self.sigma, self.shared_rounding_sd)

    @cached_property
    def resolution(self) -> Array:
        """Resolution of the instrument of each row ``(n,)``, metres or radians; 0 if none shows."""
        return np.concatenate([f.noise.step for f in self.factors])

    @cached_property
    def weighted(self) -> NDArray[np.bool_]:
        """Which rows have any weight ``(n,)``."""
        return np.concatenate([f.noise.weighted for f in self.factors])

    @property
    def single_reading_sd(self) -> ByUnit:
        """Standard deviation of a single reading, rms: of a length, and of an inclination."""
        return rms_by_unit(self.reading_sd[self.weighted], self.angular[self.weighted])

    @property
    def declared_noise(self) -> float:
        """Declared standard deviation of a length before rounding, metres; if none is declared,
        that of a single reading.
        """
        declared = self.noise.declared
        return declared if np.isfinite(declared) else self.single_reading_sd.length

    @cached_property
    def noise_by_instrument(self) -> dict[str, InstrumentNoise]:
        """For each kind of reading, in the order given: the noise of its readings; a plate's
        roughness counts as repeats.
        """
        by_kind = dict[str, InstrumentNoise]()
        for kind in dict.fromkeys(k for f in self.factors for k in f.readings.kind):
            noises = [
                f.noise.subset(f.readings.of_kind(kind) & f.noise.weighted) for f in self.factors
            ]
            total = np.concatenate([noise.total for noise in noises])
            sources = {source for noise in noises for source in noise.source.tolist()}
            source = "declared" if sources <= {"declared"} else "machine"
            if "repeats" in sources or kind in self.noise.refuted:
                source = "repeats"
            of_first_dial = bool(self.leg_factors) and not by_kind
            size = self.noise.typical if of_first_dial else float(np.sqrt(np.mean(total**2)))
            by_kind[kind] = InstrumentNoise(size, OBSERVATIONS[kind].unit, source)
        return by_kind

    @cached_property
    def repeat_counts_and_dof(self) -> tuple[tuple[int, float], ...]:
        """For each kind of reading whose repeats refute its assumed noise, and each kind of tool
        reading with noise from repeats: number of readings, and degrees of freedom of the noise.
        """
        counts = list[tuple[int, float]]()
        for factor in self.tool_factors:
            for kind in dict.fromkeys(factor.readings.kind):
                rows = factor.readings.of_kind(kind)
                if (rows & factor.noise.weighted & factor.noise.from_repeats).any():
                    dof = repeat_variance([factor.readings.subset(rows)])[1]
                    counts.append((int(np.sum(rows & factor.noise.weighted)), dof))
        counts = [(n, dof) for n, dof in counts if dof >= MIN_REPEAT_DOF]
        return (*counts, *self.noise.refuted.values())

    @cached_property
    def repeat_count(self) -> int:
        """Number of readings beyond the first of each station, which show the noise alone."""
        return int(self.weighted.sum()) - len(np.unique(self.station[self.weighted]))

    @cached_property
    def noise_dof(self) -> float:
        """Degrees of freedom of the noise of all readings, pooled over instruments by their numbers
        of readings (Satterthwaite); infinite if no noise is from repeats.
        """
        leg_reading_count = sum(len(f.measured) for f in self.leg_factors)
        counts = ((leg_reading_count, self.noise.dof), *self.repeat_counts_and_dof)
        inverse = sum((n / len(self.measured)) ** 2 / dof for n, dof in counts)
        return 1 / inverse if inverse > 0 else float("inf")

    @cached_property
    def weighing(self) -> Weighing:
        """The noise of all rows, with the errors that visits to a station share."""
        return Weighing(self.sigma, self.shared_rounding_sd, self.station)

    @cached_property
    def tolerance(self) -> Array:
        """Expected standard deviations of the unknowns ``(P,)``, SI."""
        return np.array([u.tolerance for u in self.unknowns])

    @property
    def prior_sd(self) -> Array:
        """Prior standard deviations ``(P,)``, SI; infinite where tolerances do not act."""
        if not self.use_tolerance_priors:
            return np.full(len(self.unknowns), np.inf)
        return np.asarray(self.tolerance * np.array([u.prior_width for u in self.unknowns]))

    @cached_property
    def is_from_calibration(self) -> NDArray[np.bool_]:
        """Which unknowns come from an earlier calibration and have not changed since ``(P,)``;
        their values are no news, however far beyond their tolerances, nor are located sizes.
        """
        earlier = self.earlier_posterior
        known = earlier.names if earlier and self.machine.spec.is_calibrated else ()
        return np.array([n in known or n.member == "size" for n in self.names], dtype=bool)

    def is_implausible(self, x: Array, margin: Array | float = 0.0) -> NDArray[np.bool_]:
        """Return which unknowns ``x`` ``(P,)`` are implausible by their tolerances, by more than a
        margin ``(P,)``, SI.
        """
        beyond = np.abs(self.without_common_error(x)) > MAX_TOLERANCES * self.tolerance + margin
        return np.asarray(beyond & ~self.is_from_calibration)

    def without_common_error(self, x: Array) -> Array:
        """Subtract the common mean from parameters ``x`` ``(P,)`` whose size was entered or fitted.

        A common error of such a set is a separate cause, and the tolerance of a single part does
        not limit it.
        """
        deviation, effects = np.array(x, dtype=float), [name.effect for name in self.names]
        for effect in (*self.machine.spec.entered, *self.machine.spec.fitted):
            members = [k for k, other in enumerate(effects) if other == effect]
            if len(members) > 1:
                deviation[members] -= deviation[members].mean()
        return deviation

    @cached_property
    def prior_rows(self) -> tuple[Array, Array]:
        """The prior ``|W x - t|^2``: matrix ``(k, P)`` and target ``(k,)``."""
        if self.prior_override is not None:
            return self.prior_override
        matrix, target, covered = self.correlated_prior_rows
        others = np.diag(1 / self.prior_sd)[~covered]
        return np.vstack([others, matrix]), np.concatenate([np.zeros(len(others)), target])

    @cached_property
    def correlated_prior_rows(self) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Prior rows of the unknowns whose priors are correlated, matrix ``(k, P)`` and target
        ``(k,)``, and which unknowns these are ``(P,)``.
        """
        errors = self.machine.spec.shared_errors  # as of a radius that was fitted with wrong rods
        if (earlier := self.earlier_posterior) is None:
            return shared_error_rows(self.unknowns, self.prior_sd, errors)
        shared = [(weights, sd) for weights, sd in errors if set(weights).isdisjoint(earlier.names)]
        matrix, target, covered = posterior_rows(earlier, self.unknowns)
        others, zeros, in_shared = shared_error_rows(self.unknowns, self.prior_sd, shared)
        return np.vstack([others, matrix]), np.append(zeros, target), covered | in_shared

    @cached_property
    def start(self) -> Array:
        """Initial values ``(P,)``, SI."""
        return np.array([u.start for u in self.unknowns])

    @cached_property
    def bound(self) -> Array:
        """Largest absolute values that the unknowns may take ``(P,)``, SI."""
        return np.array([u.bound for u in self.unknowns])

    def on_bound(self, x: Array) -> NDArray[np.bool_]:
        """Return which unknowns ``x`` ``(P,)`` are on their bounds."""
        return np.asarray(np.abs(x) >= self.bound * (1 - 1e-6))

    def elementary_parameters(self, factor: int) -> tuple[tuple[str, ...], Array]:
        """Return the parameters that the unknowns set for a factor, and the matrix ``(E, P)`` from
        unknowns to parameters.
        """
        parts = [u.weights[factor] for u in self.unknowns]
        names = tuple(dict.fromkeys(n for weights in parts for n in weights))
        return names, weight_matrix(names, parts)

    def machine_parameters(self, factor: int) -> tuple[tuple[str, ...], Array]:
        """Return the machine parameters that the unknowns set for a factor, and the matrix
        ``(E, P)`` from unknowns to parameters.
        """
        names, matrix = self.elementary_parameters(factor)
        machine_rows = [
            k for k, n in enumerate(names) if not self.machine.catalogue.effect_of(n).of_dial
        ]
        return tuple(names[k] for k in machine_rows), matrix[machine_rows]

    def values(self, factor: int, x: Array) -> dict[str, float]:
        """Return all parameters of a factor's machine and dials at unknowns ``x`` ``(P,)``, SI."""
        names, matrix = self.elementary_parameters(factor)
        values = dict(self.held[factor])
        for name, value in zip(names, matrix @ x, strict=True):
            values[name] = values.get(name, 0.0) + float(value)
        return values

    @property
    def last_factor_index(self) -> int:
        """Index of the factor that was read on the machine in its current state: the last table of
        readings on legs, or the last table if there are none on legs.
        """
        return (len(self.leg_factors) or len(self.factors)) - 1

    @cached_property
    def setup_of_row(self) -> NDArray[np.int64]:
        """Setup of each row, numbered over all factors ``(n,)``."""
        setups, first = [], 0
        for factor in self.factors:
            setups.append(factor.setup + first)
            first += len(factor.setup_names)
        return np.concatenate(setups)

    @cached_property
    def setups(self) -> tuple[Setup, ...]:
        """Mountings, numbered over all factors."""
        return tuple(s for f in self.factors for s in f.readings.setups)

    @property
    def leg_setups(self) -> range:
        """Numbers of the mountings on legs, which come first."""
        return range(sum(len(c.setups) for c in self.campaigns))

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of all tables of readings, stacked ``(n, ...)``."""
        return np.concatenate([getattr(f.readings, name) for f in self.factors])

    def dial_column(self, column: str) -> NDArray[Any]:
        """Return a column of the readings on legs, stacked over campaigns ``(n_legs, ...)``."""
        return np.concatenate([getattr(c, column) for c in self.campaigns])

    @cached_property
    def station(self) -> NDArray[np.int64]:
        """Station of each row ``(n,)``: visits of equal setup, command, approach and load."""
        return _consecutive_numbers([f.station for f in self.factors])

    @cached_property
    def place_number(self) -> NDArray[np.int64]:
        """Number of each row's pair of setup and command ``(n,)``, whatever the approach."""
        return _consecutive_numbers([f.readings.place_number for f in self.factors])

    @property
    def elastic(self) -> bool:
        """Whether a load deforms the bars in some posture."""
        model = self.machine.model
        return any(model.is_elastic(factor.conditions()) for factor in self.factors)

    @cached_property
    def reduction_applies(self) -> bool:
        """Whether the analytic reduction can solve this problem: one dial per reading, rigid bars,
        no URDF, no earlier posterior, and no parameters outside the base.
        """
        catalogue = self.machine.catalogue
        named = [n for k in range(len(self.factors)) for n in self.elementary_parameters(k)[0]]
        held = [n for values in self.held for n, v in values.items() if v]
        return not (
            any(s.observation.dials != 1 for s in self.setups)
            or self.earlier_posterior is not None
            or self.machine.spec.urdf
            or self.elastic
            or any(catalogue.effect_of(n).name not in catalogue.base for n in [*named, *held])
        )

    def with_prior_widths_reset(self) -> Problem:
        """Return this problem with the width of every prior reset to its tolerance."""
        narrow = tuple(replace(u, prior_width=1.0) for u in self.unknowns)
        return self if narrow == self.unknowns else replace(self, unknowns=narrow)

    @property
    def widened_parts(self) -> int:
        """Number of parts with a widened prior; zeros, which are set in a controller, are none."""
        effects = (u.name.effect for u in self.unknowns if u.prior_width > 1)
        return sum(self.machine.catalogue[effect].controller != "zero" for effect in effects)


def _consecutive_numbers(numbers: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Concatenate group numbers of several tables, offset so that no two tables share one."""
    ends = np.cumsum([0, *(int(number.max(initial=-1)) + 1 for number in numbers)])
    return np.concatenate([n + first for n, first in zip(numbers, ends, strict=False)])
