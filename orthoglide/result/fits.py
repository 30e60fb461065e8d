"""A fit of a result: its scores, its parameters, and its checks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from orthoglide.geometry import Array
from orthoglide.notes import Note
from orthoglide.numerals import ByUnit, signed
from orthoglide.result.codec import SHORT_DIGITS, Key, Metres, encoded

_FEW_DIGITS = 3  # digits of figures that are rounding themselves
_MM = 1e-3

_LINEAR_ROUNDING = 1e-9
"""Metres: rounding that is added to the bound of the linear system."""


@dataclass(frozen=True)
class Scores:
    """Figures of one fit; lengths in metres."""

    # root mean square of the residuals of lengths, datums fitted; nan if none was read
    rms: Metres
    # the papers' figure: residuals of the averaged deviations from each setup's first posture; nan
    # if no dial was read
    deviation_rms: Metres
    max: Metres  # largest residual of a length
    chi2: float  # of the data and their nuisances
    prior_chi2: float  # of the priors
    # degrees of freedom: rows, less datums, less the unknowns as far as the data determine them
    dof: float
    lack_of_fit_p: float  # probability of a chi2 this large if the model were complete
    cv_rms: Metres  # residuals of stations left out, lengths, datum refitted; nan if impossible
    # like `rms` for inclinations, radians; nan if none was read
    turn_rms: Annotated[float, Key("rms", "_mrad", _MM, omit_if_nan=True)] = math.nan
    turn_max: Annotated[float, Key("max", "_mrad", _MM, omit_if_nan=True)] = math.nan  # as `max`
    turn_cv_rms: Annotated[float, Key("cv_rms", "_mrad", _MM, omit_if_nan=True)] = math.nan

    @property
    def left(self) -> ByUnit:
        """Residuals of single readings, root mean square."""
        return ByUnit(self.rms, self.turn_rms)

    @property
    def left_out(self) -> ByUnit:
        """Residuals of stations left out, root mean square."""
        return ByUnit(self.cv_rms, self.turn_cv_rms)

    @property
    def reported(self) -> ByUnit:
        """Figures that reports state: the papers' deviations if dials were read, else residuals of
        lengths, and residuals of inclinations.
        """
        dials = math.isfinite(self.deviation_rms)
        return ByUnit(self.deviation_rms if dials else self.rms, self.turn_rms)

    @property
    def cost(self) -> float:
        """The objective of the fit: data, nuisances and priors."""
        return self.chi2 + self.prior_chi2


@dataclass(frozen=True)
class Fit:
    """One fit of a result: its parameters, and its residuals."""

    scores: Annotated[Scores, Key(inline=True)]
    values: Annotated[Mapping[str, float], Key("values_si")]  # by name of the parameter, SI
    # standard deviations, the noise of the readings multiplied by `sigma_scale`
    sigmas: Annotated[Mapping[str, float], Key("sigmas_si")]
    sigma_scale: float  # sqrt(chi2 / dof) where lack of fit remains, else 1
    coverage_factor: float  # half width of a 95 % interval in sigmas
    on_bound: tuple[str, ...]  # names of values that ended on a bound
    method: str  # `nlp`, `nested`, `pinocchio`, `reduction` or `posterior`
    iterations: int  # of the solver
    # step of one more Newton iteration, in sigmas
    optimality: Annotated[float, Key("last_step_in_sigmas", digits=_FEW_DIGITS)]
    warnings: tuple[Note, ...]  # in sentences

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the identified parameters."""
        return tuple(self.values)


@dataclass(frozen=True)
class HoldOut:
    """Scores on readings of another campaign, each predicted without itself."""

    before: Annotated[ByUnit, Key("before_rms")]  # root mean square residual of the base model
    after: Annotated[ByUnit, Key("after_rms")]  # of the extended model

    @property
    def worse(self) -> bool:
        """Whether the extended model predicts worse: by the geometric mean of the ratios for
        lengths and for inclinations.
        """
        before, after = (math.prod(both.shown.values()) for both in (self.before, self.after))
        return after > before


@dataclass(frozen=True)
class TcpErrors:
    """Errors of three machines at measured points, metres: mean and largest distance."""

    nominal_mean: Metres  # of the machine without errors
    nominal_max: Metres
    before_mean: Metres  # of the base model
    before_max: Metres
    after_mean: Metres  # of the extended model
    after_max: Metres
    # share of the coordinates within the 95 % interval stated for `after`; nan without one
    inside: Annotated[float, Key("inside_95", digits=SHORT_DIGITS, omit_if_nan=True)] = math.nan

    @property
    def nominal(self) -> tuple[float, float]:
        """Mean and largest error of the machine without errors."""
        return self.nominal_mean, self.nominal_max

    @property
    def before(self) -> tuple[float, float]:
        """Mean and largest error of the base model."""
        return self.before_mean, self.before_max

    @property
    def after(self) -> tuple[float, float]:
        """Mean and largest error of the extended model."""
        return self.after_mean, self.after_max


@dataclass(frozen=True)
class WeakDirection:
    """A direction in the parameters that the readings hardly determine."""

    # their shares along the direction; squares sum to one
    parameters: Annotated[Mapping[str, float], Key(digits=SHORT_DIGITS)]
    # standard deviation along it from the readings alone, in `unit`; infinite if undetermined
    sigma: Annotated[float, Key(digits=SHORT_DIGITS, null=math.inf)]
    # standard deviation with the tolerances as priors; equal without priors
    sigma_with_priors: Annotated[float, Key(digits=SHORT_DIGITS, null=math.inf)]
    unit: str  # of both

    def __str__(self) -> str:
        along = " ".join(f"{signed(share, 2)} {name}" for name, share in self.parameters.items())
        is_seen = math.isfinite(self.sigma)
        size = f"sigma {self.sigma:.2g} {self.unit}" if is_seen else "nothing is seen"
        prior = f", with the tolerances as priors {self.sigma_with_priors:.2g} {self.unit}"
        narrowed = self.sigma_with_priors < 0.5 * self.sigma
        return f"weak direction {along}: {size}{prior * narrowed}"


@dataclass(frozen=True)
class CrossCheck:
    """Differences of the independent derivations, metres."""

    # largest difference of a parameter between the mechanism and the reduction's nonlinear fit
    reduction: Annotated[float, Key("reduction_max_difference", "_mm", _MM, _FEW_DIGITS)]
    # largest difference of a fitted reading between the mechanism and system (11)
    linear: Annotated[float, Key("linear_system_max_difference", "_mm", _MM, _FEW_DIGITS)]
    # bound of second-order terms on the differences, root mean square over the noise
    linear_bound: Annotated[float, Key("linear_system_rms_bound", "_mm", _MM, _FEW_DIGITS)]
    # differences of fitted readings in the same norm
    linear_size: Annotated[float, Key("linear_system_rms_difference", "_mm", _MM, _FEW_DIGITS)]
    # parameters that the linear system gives (P,); not in the file
    linear_values: Annotated[Array, Key(in_file=False)] = field(
        default_factory=lambda: np.zeros(0), repr=False, compare=False
    )

    @property
    def second_order(self) -> bool:
        """Whether the linear system differs by no more than its neglected second-order terms."""
        return self.linear_size <= self.linear_bound * (1 + 1e-6) + _LINEAR_ROUNDING


@dataclass(frozen=True)
class Verification:
    """Differences between Pinocchio's closed postures and those of the fit."""

    # largest closure residual by loop, metres or radians
    closure: Annotated[Mapping[str, float], Key("closure_residual_m", digits=_FEW_DIGITS)]
    # largest difference of the TCP, metres
    tcp: Annotated[float, Key("tcp_max_difference", "_mm", _MM, _FEW_DIGITS)]
    # largest difference of a derivative with respect to travel or a virtual joint, relative to the
    # largest derivative of the same output, or to a thousandth
    sensitivity: Annotated[float, Key("sensitivity_max_relative_difference", digits=_FEW_DIGITS)]
    postures: int  # number of closed postures

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``result.json``."""
        found: dict[str, Any] = encoded(self)
        return found
