"""A fit of a result: scores, parameters, budget, residuals, noise, data faults and changes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from orthoglide.geometry import LEGS, Array
from orthoglide.instruments import OBSERVATIONS
from orthoglide.notes import Note
from orthoglide.numerals import ByUnit, signed
from orthoglide.result.codec import SHORT_DIGITS, Key, Metres, SampledMetres, Share, in_mm

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


@dataclass(frozen=True)
class BudgetItem:
    """One row of the error budget; metres unless stated otherwise."""

    cause: str  # name of a cause, of a free-form error, or of an effect
    words: str  # the cause without its size, a clause
    members: tuple[str, ...]  # its parameters, and others with identical readings and TCP errors
    value: float  # in `unit`; nan for several parameters
    sigma: float  # standard deviation of `value`
    unit: str  # as in files
    tolerances: Share  # largest ratio of a parameter to its tolerance
    beyond_tolerance: Share  # probability that any parameter exceeds its tolerance
    # root mean square of its contribution to the readings, datums fitted
    readings: Annotated[ByUnit, Key("readings_rms", digits=SHORT_DIGITS)]
    tcp_mean: SampledMetres  # mean of its contribution to the TCP error
    tcp_sigma: SampledMetres  # standard deviation of `tcp_mean`
    gain: SampledMetres  # decrease of the mean TCP error if the fault is repaired
    gain_sigma: SampledMetres  # standard deviation of `gain`
    # decrease of the mean TCP error if the estimate is compensated and its uncertainty remains
    compensated: SampledMetres
    compensated_sigma: SampledMetres  # standard deviation of `compensated`
    # `gain` over the mean TCP error
    share: Annotated[float, Key("gain_share", digits=SHORT_DIGITS)]
    rest: bool = False  # whether it is an effect without the causes found, not a cause found


@dataclass(frozen=True)
class Identified:
    """One identified parameter."""

    value: float  # in `unit`
    sigma: float  # standard deviation of the full model; of the noise alone after `identify`
    unit: str  # as in files
    interval_95: tuple[float, float]  # in `unit`
    tolerance: float  # prior standard deviation, in `unit`
    on_bound: bool  # whether the value ended on its bound


# --- Residuals -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SetupResidual:
    """Residuals of one mounting of a dial, or of one axis of an instrument at the tool."""

    setup: str  # name of the mounting
    kind: str  # kind of its readings
    leg: int  # 0, 1 or 2: leg that the dial touches; -1 at the tool
    axis: int  # 0, 1 or 2: base axis along or about which it reads
    share: Share  # of the sum of all squared residuals, each divided by its variance
    rms: Annotated[float, Key(digits=SHORT_DIGITS)]  # root mean square, metres or radians
    # largest mean over one station along +axis, with its sign
    most: Annotated[float, Key(digits=SHORT_DIGITS)]
    # label of that station; empty if it has none, or another station's residual is as large
    posture: str
    command: Array  # at that station (3,), metres
    # positions of the tool with the largest residuals, largest first, in the controller's
    # coordinates and millimetres; empty for a dial
    where: tuple[str, ...]
    file: str = ""  # name of its file, without its ending

    @property
    def reads(self) -> str:
        """The quantity that is read, in words."""
        return OBSERVATIONS[self.kind].quantity_phrase.format(LEGS[self.axis], LEGS[self.leg])

    @property
    def unit(self) -> str:
        """Unit for display: mm or mrad."""
        return OBSERVATIONS[self.kind].unit


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """The residuals of the last fit: whether they exceed the noise, and where they are largest."""

    # probability that noise alone leaves residuals this large; nan where it was not computed
    p_value: Annotated[float, Key("lack_of_fit_p", digits=SHORT_DIGITS)]
    # typical size of the effects that are not reported, as a share of their tolerances; nan after
    # `identify`
    background: Share = math.nan
    # probability that the machine exceeds all tolerances, or that the noise is larger than the
    # repeats show
    rare: Annotated[float, Key("rare_probability", digits=SHORT_DIGITS)] = 0.0
    shaped: Share = 0.0  # `p_value` if probed plates may have shapes that no effect describes
    # `p_value` if causes count that are not probable enough to be reported
    with_unreported: Share = 0.0
    stopped: str = "no cause was to be added"  # why the search ended, a clause
    # of every mounting of a dial, largest share first, then of every instrument at the tool
    mountings: tuple[SetupResidual, ...] = ()
    base_p_value: Annotated[float, Key(in_file=False)] = 1.0  # `p_value` of the base model alone
    # whether errors within all tolerances explain the readings, and predict stations left out
    explained_within_tolerances: Annotated[bool, Key(in_file=False)] = False

    @property
    def by_dial(self) -> tuple[SetupResidual, ...]:
        """Residuals of every mounting of a dial, largest share first."""
        return tuple(one for one in self.mountings if one.leg >= 0)

    @property
    def by_instrument(self) -> tuple[SetupResidual, ...]:
        """Residuals of every instrument at the tool, largest share first."""
        return tuple(one for one in self.mountings if one.leg < 0)

    @property
    def dials_hold_most(self) -> bool:
        """Whether the mounting with the largest share is a dial's; false without dials."""
        tool = max((one.share for one in self.by_instrument), default=-1.0)
        return any(one.share >= tool for one in self.by_dial[:1])


@dataclass(frozen=True)
class InstrumentNoise:
    """Noise of one instrument."""

    sigma: Annotated[float, Key("sigma_si")]  # standard deviation of one reading, SI
    unit: str  # unit for display: mm or mrad
    source: str  # `declared`, `machine` or `repeats`

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        return {self.unit: in_mm(self.sigma)}


@dataclass(frozen=True)
class Noise:
    """Noise of the readings."""

    declared: Annotated[float, Key("noise", "_mm", _MM)]  # of one length without rounding
    single_reading: Annotated[ByUnit, Key("one_reading")]  # of a single reading with rounding
    source: Annotated[str, Key("noise_source")]  # source of the first instrument's noise
    by_instrument: Annotated[Mapping[str, InstrumentNoise], Key("noise_of")]  # by kind of readings

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        turn = in_mm(self.single_reading.turn)
        return {} if turn is None else {"noise_mrad": turn}


@dataclass(frozen=True)
class SetupNoise:
    """Noise of the readings of one setup, estimated from the residuals."""

    setup: str  # name of the setup
    file: str  # name of the file, or of the campaign if there is none
    kind: str  # of its readings
    # standard deviation assumed for one reading, root mean square, metres or radians
    sigma: Annotated[float, Key(suffix="_mm", si=_MM, digits=SHORT_DIGITS)]
    # ratio of the noise that the residuals show to `sigma`; nan if they show none
    scale: Share
    scale_sigma: Share  # standard deviation of `scale`


@dataclass(frozen=True)
class DataFault:
    """A fault of the data: readings that no machine produces."""

    kind: str  # `outlier`, `knocked_stand`, `moved`, `command` ...
    rows: tuple[int, ...]  # lines of the files
    files: Mapping[str, tuple[int, ...]]  # the same lines by name of the file
    setups: tuple[str, ...]  # names of the affected setups
    message: str  # file, lines, the likely reason, and the remedy
    # decrease of chi2 by this fault, after the faults before it in the list
    improvement: Annotated[float, Key("chi2_less", digits=SHORT_DIGITS)]
    rms_with: Metres  # of the residuals with the faulty readings
    rms_without: Metres  # of the residuals without them
    # pairs of the number of the readings within the request and the row within them
    rows_in_request: tuple[tuple[int, int], ...]
    excluded: bool  # whether the rows are excluded; if not, they have a datum of their own


@dataclass(frozen=True, repr=False)
class Change:
    """A parameter of the machine that changed between two files, or since a calibration."""

    parameter: str  # the most probable one
    # parameters whose change these readings cannot distinguish from its change, itself first
    members: tuple[str, ...]
    before: Annotated[float, Key("from")]  # value before the change, in `unit`
    after: Annotated[float, Key("to")]  # value after the change
    sigma: float  # standard deviation of the difference
    unit: str  # as in files
    files: Annotated[tuple[str, str], Key("between")]  # the last before and the first after it
    message: Annotated[str, Key("words")]  # a clause: between which files, what, by how much
    vague: bool  # whether `before` is an average over causes that could not be distinguished
    when: str  # between which files, a clause
    what: str  # the parameter, its values, and the alternatives, a clause
    each: tuple[str, ...]  # the members, a clause each
    evidence: Share  # log Bayes factor for the change, the number of candidates included
    loses: bool  # whether it may be lost motion, which the expected errors of the tool exclude

    def __repr__(self) -> str:
        return f"<Change of {self.parameter}: {self.message}>"
