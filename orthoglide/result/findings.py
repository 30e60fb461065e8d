"""Causes found in a machine, located errors, the error budget, and what to do about them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Literal, Protocol, TypeVar

import numpy as np

from orthoglide.geometry import Array
from orthoglide.numerals import ByUnit
from orthoglide.result.codec import SHORT_DIGITS, Key, SampledMetres, Share, encoded, in_mm_short
from orthoglide.result.fits import Scores

_FAULT_PHRASES = {
    "command": "another command than the one written",
    "outlier": "a slip of the reading",
    "knocked_stand": "a dial's stand that was knocked",
    "zeroed": "a dial that was set to zero anew",
    "moved": "an instrument that was moved",
}
"""Data faults that can explain the readings as a cause does, as noun phrases."""


@dataclass(frozen=True, eq=False, repr=False)
class Explanation:
    """One cause of the catalogue, conditional on everything else that was found."""

    name: str  # name of the cause
    parameters: tuple[str, ...]  # parameters that it consists of
    # in `unit`; nan if it has several parameters; the last campaign's if it is specific to each
    value: float
    sigma: float  # standard deviation of `value`
    unit: str  # of its parameters in files
    probability: Share  # conditional on the other causes found
    words: str  # the error with its size and sign, a clause
    look_at: str  # the part of the machine to look at
    confirm: str  # a test with the expected reading; empty if there is none
    half_width: str  # of the 95 % interval of its size, with the unit; empty for several parameters
    values: Annotated[Mapping[str, float], Key("values_si")]  # by parameter, SI
    sigmas: Annotated[Mapping[str, float], Key("sigmas_si")]  # standard deviations of `values`
    # predicted contribution to the readings, datums fitted (n,), metres or radians; empty for a
    # cause that no figure shows
    shown: Annotated[Array, Key("shown_si", digits=SHORT_DIGITS)]

    def __repr__(self) -> str:
        return f"<{self.name}, probability {self.probability:.2f}: {self.words}>"


@dataclass(frozen=True, eq=False, repr=False)
class Curve:
    """A free-form error: an error function of one part, without a name in the catalogue."""

    name: str  # name of the part and of its motion
    leg: str | None  # name of the leg; none of an instrument or of all legs
    part: str  # of the machine, or `dial`
    direction: str | None  # base axis along or about which the part moves
    # argument of the function: `travel`, `command`, `approach`, `reversal`, `time` or `reading`
    against: str
    short_waves: bool  # whether the function has waves of a few centimetres
    by_leg: str | None  # leg whose command is the argument
    setup: str | None  # mounting of the dial
    probability: Share  # conditional on the other causes found
    unit: str  # unit for display: mm or mrad
    description: str  # the error without its size, a clause
    # SI; lost motion between the two directions of approach, else the root mean square
    size: Annotated[float, Key("size_si", digits=SHORT_DIGITS)]
    size_words: str  # size with its unit, and whether it is a root mean square
    # arguments at which the function is evaluated (k,): metres or seconds
    at: Annotated[Array, Key("at_si", digits=SHORT_DIGITS)]
    # values there (k,), SI; without their mean unless it is lost motion, as a constant cannot be
    # distinguished from the zeros
    value: Annotated[Array, Key("value_si", digits=SHORT_DIGITS)]
    # standard deviations of `value` (k,)
    sigma: Annotated[Array, Key("sigma_si", digits=SHORT_DIGITS)]
    of_dial: bool  # whether it belongs to a dial
    of_machine: bool  # whether the calibrated machine includes it

    def __repr__(self) -> str:
        return f"<{self.name}, probability {self.probability:.2f}: {self.size_words}>"

    @property
    def words(self) -> str:
        """The error with its size, a clause."""
        return f"{self.description}, by {self.size_words}"

    @property
    def words_with_measure(self) -> str:
        """The error with its size and the definition of that size, a clause."""
        of_a_place = " of coming to a place" * (not self.of_dial)
        ways = {"approach": f"between the two ways{of_a_place}", "reversal": "from the turn on"}
        size = self.size_words.removesuffix(" rms")
        if self.against not in ways and size == self.size_words:  # of a bump
            return self.words
        return f"{self.description}, by {size} ({ways.get(self.against, 'root mean square')})"

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        return {
            f"rms_{self.unit}": in_mm_short(float(self.value.std())),
            f"size_{self.unit}": in_mm_short(self.size),
        }


@dataclass(frozen=True)
class Possible:
    """A cause that is not probable enough to be added, conditional on its presence."""

    name: str  # name of the cause
    parameters: tuple[str, ...]  # parameters that it consists of
    probability: Share
    words: str  # the error with its size and sign, a clause
    after: Scores  # of the base model with this cause added


@dataclass(frozen=True)
class DataRival:
    """A fault of the data that explains the readings as well as a cause of the machine."""

    data: str  # its kind, as of a data fault
    rows: tuple[int, ...]  # lines of the files
    probability: Share  # conditional on the other causes found
    words: str  # file, lines, the likely reason, and the remedy

    @property
    def file(self) -> str:
        """Name of the file of its lines, without the folder."""
        return self.words.partition(", ")[0]

    @property
    def brief(self) -> str:
        """The fault with its file and its first line, a clause."""
        what = _FAULT_PHRASES.get(self.data, "a fault of the data")
        if self.data == "outlier" and len(set(self.rows)) > 1:
            what = "one dial that reads wrong at one place"
        return f"{what} in {self.file}, line {min(self.rows)}"


class _Named(Protocol):
    """An explanation with a name."""

    @property
    def name(self) -> str: ...
    @property
    def words(self) -> str: ...
    @property
    def parameters(self) -> tuple[str, ...]: ...
    @property
    def probability(self) -> float: ...


E = TypeVar("E", bound=_Named)
C = TypeVar("C")


class CredibleSet(Generic[E, C]):
    """A cause with its alternatives, in the search and in a result.

    Attributes:
        chosen: the most probable explanation.
        rivals: alternatives that move the tool differently.
        same: alternatives that move the tool identically.
        places: free-form errors in the set, which are less probable.
    """

    chosen: E
    rivals: tuple[E, ...]
    same: tuple[E, ...]
    places: tuple[C, ...]

    def __repr__(self) -> str:
        others = ", ".join(self.indistinguishable_from)
        return f"<Cause {self.name}: {self.chosen.words}{others and f'; or {others}'}>"

    @property
    def name(self) -> str:
        """Name of the most probable explanation."""
        return self.chosen.name

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters of the most probable explanation."""
        return self.chosen.parameters

    @property
    def probability(self) -> float:
        """Probability of that explanation, conditional on the other causes found."""
        return self.chosen.probability

    @property
    def together(self) -> float:
        """Probability of the explanations that move the tool as the most probable one does."""
        return sum(one.probability for one in (self.chosen, *self.same))

    @property
    def explanations(self) -> tuple[E, ...]:
        """All named explanations in the credible set."""
        return (self.chosen, *self.same, *self.rivals)

    @property
    def others(self) -> tuple[E | C, ...]:
        """The alternatives, named and free-form."""
        return (*self.rivals, *self.places)

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        """Names of the other explanations in the credible set."""
        return tuple(one.name for one in (*self.same, *self.rivals))


@dataclass(frozen=True, eq=False, repr=False)
class Cause(CredibleSet[Explanation, Curve]):
    """One cause that was found, with its credible set."""

    chosen: Annotated[Explanation, Key(inline=True)]  # the most probable explanation
    rivals: tuple[Explanation, ...]  # alternatives that move the tool differently
    same: tuple[Explanation, ...]  # alternatives that move the tool identically
    places: tuple[Curve, ...]  # free-form errors in the set, which are less probable
    loses: bool  # whether it may be lost motion, which the expected errors of the tool exclude
    # faults of the data in the same credible set
    data: Annotated[tuple[DataRival, ...], Key("rivals_in_data")] = ()

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        return {"indistinguishable_from": list(self.indistinguishable_from)}


@dataclass(frozen=True, eq=False, repr=False)
class Located:
    """A located error: several free-form errors that cannot be distinguished, one of them true."""

    members: Annotated[tuple[Curve, ...], Key("class")]  # most probable first
    # probability that it is one of the members, conditional on the other causes found
    probability: Annotated[float, Key("class_probability", digits=SHORT_DIGITS)]
    resembling: tuple[str, ...]  # names of causes in the same credible set
    resembling_words: tuple[str, ...]  # the same causes as clauses without a size
    # causes that move the part of the first member and are not in the set, clauses without a size
    ruled_out: tuple[str, ...]
    in_budget: str  # its name in the error budget
    loses: bool  # whether it may be lost motion, which the expected errors of the tool exclude
    # faults of the data in the same credible set
    data: Annotated[tuple[DataRival, ...], Key("rivals_in_data")] = ()

    def __repr__(self) -> str:
        return f"<Located {', '.join(map(repr, self.members))}>"

    @property
    def name(self) -> str:
        """Name of the most probable member."""
        return self.members[0].name

    @property
    def words(self) -> str:
        """The most probable member with its size, a clause."""
        return self.members[0].words_with_measure

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        first = self.members[0]
        timed = first.against == "time"
        points = np.column_stack([first.at * (1.0 if timed else 1e3), first.value * 1e3,
                                  first.sigma * 1e3])  # fmt: skip
        return {
            **encoded(first),
            "curve": encoded(points, Key(digits=SHORT_DIGITS)),
            "at_unit": "s" if timed else "mm",
            "words": self.words,
        }


@dataclass(frozen=True)
class CandidateScore:
    """A cause or free-form error that the search considered."""

    name: str  # name of the cause or free-form error
    parameters: tuple[str, ...]  # parameters of the cause; empty for a free-form error
    probability: Share  # that it is larger than the background of small errors
    # log Bayes factor for that, conditional on the other causes found
    evidence: Share
    words: str = ""  # the cause without its size, a clause

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that earlier versions computed, with fixed values."""
        return {"p_value": None, "cv_rms_mm": None, "plausible": True}


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


# --- What follows ---------------------------------------------------------------------------

Kind = Literal["zeros", "confirm", "mend", "compensate", "measure"]

_ADVICE_NAMES = {
    "zeros": "zeros", "mend": "repair", "compensate": "compensate", "measure": "measure",
}  # fmt: skip


@dataclass(frozen=True)
class Suspect:
    """A possible cause with the part to examine."""

    words: str  # the error with sign, size and unit, a clause
    look_at: str  # part of the machine to look at
    confirm: str  # a test with the expected reading; empty if there is none


@dataclass(frozen=True)
class Action:
    """One thing to do."""

    # `zeros` to enter, a cause to `confirm` or to `mend`, commands to `compensate`, or readings to
    # `measure`
    kind: Annotated[Kind, Key("action")]
    words: str  # what to do, a sentence without its full stop
    # decrease of the tool's mean error over the workspace, best shift removed, or for numbers of a
    # firmware of the residual of its equations; nan for actions that change nothing on the machine
    gain: SampledMetres = math.nan
    gain_sigma: SampledMetres = math.nan  # standard deviation of `gain`; nan if unknown
    options: tuple[Suspect, ...] = ()  # causes to look for, most probable first
    whichever: bool = False  # whether `gain` is the mean over the options, one of which is true
    plate: bool = False  # whether an option is an error of the plate, which does not move the tool


@dataclass(frozen=True)
class Withheld:
    """Something that is not advised."""

    kind: Literal["zeros", "compensate"]
    reason: str  # a clause


def advice_rows(actions: tuple[Action, ...]) -> list[dict[str, Any]]:
    """Return the entries of ``advice`` in ``result.json``: actions except causes to confirm."""
    return [
        {
            "kind": _ADVICE_NAMES[one.kind], "words": one.words,
            "gain_mm": in_mm_short(one.gain), "gain_sigma_mm": in_mm_short(one.gain_sigma),
        }
        for one in actions
        if one.kind in _ADVICE_NAMES
    ]  # fmt: skip


@dataclass(frozen=True)
class Proposal:
    """A few readings to take next, and why."""

    reason: str  # their purpose and the expected outcome, in words
    # `separate` rivals, `narrow` a weak direction, `trace` an unexplained residual, or `none`
    aim: str
    # separation in sigmas of the two least separated rivals, by another instrument of the two most
    # separated; ratio of standard deviations of a weak direction; nan for a residual
    gain: Share
    readings: tuple[Mapping[str, str], ...]  # rows of a campaign file, without readings
    what: str  # what to measure, without the expected outcome; empty: the whole reason
    other_instrument: bool  # whether it takes another instrument or another way of measuring
    hopeless: bool  # whether no feasible reading helps
