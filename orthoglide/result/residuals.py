"""Residuals and noise of a result's readings, faults of the data, and changes between visits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from orthoglide.geometry import LEGS, Array
from orthoglide.instruments import OBSERVATIONS
from orthoglide.numerals import ByUnit
from orthoglide.result.codec import SHORT_DIGITS, Key, Metres, Share, in_mm

_MM = 1e-3


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
    background: Share
    # probability that the machine exceeds all tolerances, or that the noise is larger than the
    # repeats show
    rare: Annotated[float, Key("rare_probability", digits=SHORT_DIGITS)]
    shaped: Share  # `p_value` if probed plates may have shapes that no effect describes
    with_unreported: Share  # `p_value` if causes count that are not probable enough to be reported
    stopped: str  # why the search ended, a clause
    # of every mounting of a dial, largest share first, then of every instrument at the tool
    mountings: tuple[SetupResidual, ...]

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
    covered_by_cause: bool  # whether a cause in the same result already reports it

    def __repr__(self) -> str:
        return f"<Change of {self.parameter}: {self.message}>"
