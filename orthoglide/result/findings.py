"""Causes found in a machine, and located errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from orthoglide.effects import Catalogue, Effect, wording
from orthoglide.effects.free_form_words import size_place
from orthoglide.geometry import Array
from orthoglide.numerals import SIGMAS_95
from orthoglide.parameters import Parameter, split_campaign
from orthoglide.result.codec import SHORT_DIGITS, Key, Share, encoded, in_mm_short
from orthoglide.result.fits import Scores

FAULT_NAMES = {
    "outlier": "a slip of the reading",
    "knocked_stand": "a stand that was knocked",
    "zeroed": "a dial set to zero anew at each repeat",
    "command": "another command than the one written",
    "sign": "a dial that counted the other way",
    "label": "a setup of another leg or direction",
    "exchanged_labels": "two setups exchanged",
    "shifted": "readings a row too late or too early",
    "unit": "a wrong unit",
    "turns": "readings whole turns of the hand off",
    "stuck": "a dial that stuck",
    "noisy": "a setup noisier than assumed",
    "scatter": "visits that do not repeat",
    "moved": "an instrument that was moved",
    "drifted": "an instrument that drifted",
}
"""Kinds of data faults as noun phrases."""


@dataclass(frozen=True, eq=False, repr=False)
class Explanation:
    """One cause of the catalogue, conditional on everything else that was found."""

    name: str  # name of the cause
    parameters: tuple[str, ...]  # parameters that it consists of, as `with_free` takes them
    probability: Share  # conditional on the other causes found
    values: Annotated[Mapping[str, float], Key("values_si")]  # by parameter, SI
    sigmas: Annotated[Mapping[str, float], Key("sigmas_si")]  # standard deviations of `values`
    catalogue: Catalogue  # effects of the machine, its own among them
    # all parameters of the machine with this cause, SI; empty in a result
    machine: Annotated[Mapping[str, float], Key(in_file=False)] = field(default_factory=dict)
    # names of candidates with more parameters, of which only these are not zero
    families: Annotated[tuple[str, ...], Key(in_file=False)] = ()

    def __repr__(self) -> str:
        return f"<{self.name}, probability {self.probability:.2f}: {self.words}>"

    @property
    def effect(self) -> Effect:
        """Effect of its parameters."""
        return self.catalogue.effect_of(self.name)

    @property
    def unit(self) -> str:
        """Unit of its parameters in files."""
        return self.effect.unit.name

    @property
    def value(self) -> float:
        """Its size in `unit`, of a pair its amplitude, in the last campaign; nan of others."""
        return self._size_and_high_side[0] / self.effect.unit.si

    @property
    def sigma(self) -> float:
        """Standard deviation of `value`; of a pair to first order, its parts taken as independent,
        as they are where readings surround the plate or the turn of a screw.
        """
        si, names = self.effect.unit.si, self._last_names.values()
        if not math.isfinite(self.value):
            return math.nan
        sizes = {n: self.values[n] if len(self._last_names) > 1 else 1.0 for n in names}
        weighted = math.hypot(*(size * self.sigmas[n] for n, size in sizes.items()))
        return weighted / math.hypot(*sizes.values()) / si

    @property
    def high_side(self) -> float:
        """Direction of a high side of a plate, degrees counter-clockwise from +x; nan of others."""
        return self._size_and_high_side[1]

    @property
    def _last_names(self) -> dict[Parameter, str]:
        """Names of its parameters in the last campaign, by parameter without a campaign."""
        return {self.catalogue.parameter(n).plain: n for n in self.parameters}

    @property
    def _size_and_high_side(self) -> tuple[float, float]:
        """Size of one parameter or pair, SI, and direction of a high side; nan of several."""
        places = {p.undirected if self.effect.paired else p for p in self._last_names}
        if len(places) > 1:
            return math.nan, math.nan
        values = {str(p): self.values[n] for p, n in self._last_names.items()}
        return wording.size_and_high_side(self.catalogue, values)

    @property
    def half_width(self) -> str:
        """Half width of the 95 % interval of its size with the unit; empty if it has several
        parameters.
        """
        width = self.sigma * self.effect.unit.si * SIGMAS_95
        return wording.size_words(self.effect, width) if math.isfinite(width) else ""

    @property
    def words(self) -> str:
        """The error with its size and sign, a clause; for each campaign if these differ."""
        if split_campaign(self.name)[1]:
            return wording.cause_words(self.catalogue, self.name, dict(self.values))
        by_campaign = dict[str, dict[str, float]]()
        for name, value in self.values.items():
            parameter = self.catalogue.parameter(name)
            by_campaign.setdefault(parameter.campaign, {})[parameter.plain] = value
        several = len(by_campaign) > 1
        return ", and ".join(
            wording.cause_words(self.catalogue, self.name, values)
            + f" ({campaign})" * several * bool(campaign)
            for campaign, values in by_campaign.items()
        )

    @property
    def exceeds_uncertainty(self) -> bool:
        """True if any parameter is larger than its uncertainty; else the cause explains nothing."""
        return any(abs(value) > self.sigmas[n] for n, value in self.values.items())

    @property
    def loses(self) -> bool:
        """Whether it is lost motion, which the expected errors of the tool exclude."""
        return any("approach" in self.catalogue.effect_of(n).needs for n in self.parameters)

    @property
    def look_at(self) -> str:
        """The part of the machine to look at."""
        return self.effect.look_at

    @property
    def confirm(self) -> str:
        """A test with the expected reading in the last campaign; empty where `value` is nan."""
        first, value = next(iter(self._last_names)), self._size_and_high_side[0]
        if first.member or not math.isfinite(value):
            return ""
        campaigns = [self.catalogue.parameter(n).campaign for n in self.parameters]
        campaign = campaigns[-1] if len(set(campaigns)) > 1 else ""
        words = wording.confirm_words(self.effect, first, value, self.high_side)
        return words + f" (as in {campaign})" * bool(campaign)

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        names = ("value", "sigma", "unit", "words", "look_at", "confirm", "half_width")
        keys = {name: encoded(getattr(self, name)) for name in names}
        degrees = {"high_side_deg": in_mm_short(self.high_side * 1e-3)}
        return keys | (degrees if math.isfinite(self.high_side) else {})


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
    # SI; of a bump, jump or change with time the largest value, with its sign, of a reversal the
    # range, else the root mean square, of a line with its sign
    size: Annotated[float, Key("size_si", digits=SHORT_DIGITS)]
    size_words: str  # size with its unit, and whether it is a root mean square
    # arguments at which the function is evaluated (k,): metres or seconds
    at: Annotated[Array, Key("at_si", digits=SHORT_DIGITS)]
    # values there (k,), SI; over travel without their mean, which cannot be told from the zeros
    value: Annotated[Array, Key("value_si", digits=SHORT_DIGITS)]
    # standard deviations of `value` (k,)
    sigma: Annotated[Array, Key("sigma_si", digits=SHORT_DIGITS)]
    of_dial: bool  # whether it belongs to a dial
    of_machine: bool  # whether the calibrated machine includes it
    # standard deviation of `size`, its shape's included; nan in results of earlier versions
    size_sigma: Annotated[float, Key("size_sigma_si", digits=SHORT_DIGITS)] = math.nan
    # the `FreeForm` that the search located; none in a loaded result
    place: Annotated[Any, Key(in_file=False)] = None
    # its coefficients in their prior standard deviations (k,); none in a loaded result
    coefficients: Annotated[Any, Key(in_file=False)] = None

    def __repr__(self) -> str:
        return f"<{self.name}, probability {self.probability:.2f}: {self.size_words}>"

    @property
    def loses(self) -> bool:
        """Whether it is lost motion of the machine."""
        return self.against in ("approach", "reversal") and not self.of_dial

    @property
    def words(self) -> str:
        """The error with its size, a clause."""
        return f"{self.description}, by {self.size_words}{size_place(self.part)}"

    @property
    def words_with_measure(self) -> str:
        """The error with its size and the definition of that size, a clause."""
        of_a_place = " of coming to a place" * (not self.of_dial)
        ways = {"approach": f"between the two ways{of_a_place}", "reversal": "from the turn on"}
        size = self.size_words.removesuffix(" rms")
        if self.against not in ways and size == self.size_words:  # of a bump
            return self.words
        measure = ways.get(self.against, "root mean square")
        return f"{self.description}, by {size}{size_place(self.part)} ({measure})"

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        sizes = {"rms": float(self.value.std()), "size": self.size, "size_sigma": self.size_sigma}
        return {f"{name}_{self.unit}": in_mm_short(size) for name, size in sizes.items()}


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
    """A data fault that is an alternative to a cause of the machine in its credible set."""

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
        """The fault with its file and its lines, a clause."""
        what = FAULT_NAMES.get(self.data, self.data)
        if self.data == "outlier" and len(set(self.rows)) > 1:
            what = "one dial that reads wrong at one place"
        return f"a fault of the data: {what} in {self.file}, {self.lines}"

    @property
    def lines(self) -> str:
        """Its lines as words: a range if they follow each other, else how many follow the first."""
        first, last, more = min(self.rows), max(self.rows), len(set(self.rows)) - 1
        if last - first == more > 0:
            return f"lines {first} to {last}"
        return f"line {first}" + f" and {more} more" * (more > 0)


@dataclass(frozen=True, eq=False, repr=False)
class Cause:
    """One cause that was found, with its credible set."""

    chosen: Annotated[Explanation, Key(inline=True)]  # the most probable explanation
    rivals: tuple[Explanation, ...] = ()  # alternatives that move the tool differently
    same: tuple[Explanation, ...] = ()  # alternatives that move the tool identically
    places: tuple[Curve, ...] = ()  # free-form errors in the set, which are less probable
    # faults of the data in the same credible set
    data: Annotated[tuple[DataRival, ...], Key("rivals_in_data")] = ()

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
    def explanations(self) -> tuple[Explanation, ...]:
        """All named explanations in the credible set."""
        return (self.chosen, *self.same, *self.rivals)

    @property
    def others(self) -> tuple[Explanation | Curve, ...]:
        """The alternatives, named and free-form."""
        return (*self.rivals, *self.places)

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        """Names of the other explanations in the credible set."""
        return tuple(one.name for one in (*self.same, *self.rivals))

    @property
    def all_parameters(self) -> tuple[str, ...]:
        """Parameters of the whole credible set."""
        return tuple(name for one in self.explanations for name in one.parameters)

    @property
    def loses(self) -> bool:
        """Whether it may be lost motion, which the expected errors of the tool exclude."""
        return self.chosen.loses

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        others = list(self.indistinguishable_from)
        return {"indistinguishable_from": others, "loses": self.loses}


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
    # faults of the data in the same credible set
    data: Annotated[tuple[DataRival, ...], Key("rivals_in_data")] = ()
    # parameters of the calibrated machine with these errors; empty in a loaded result
    parameters: Annotated[tuple[str, ...], Key(in_file=False)] = ()
    # active group of the search to which the members are alternatives; -1 in a loaded result
    group: Annotated[int, Key(in_file=False)] = -1

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

    @property
    def loses(self) -> bool:
        """Whether it may be lost motion, which the expected errors of the tool exclude."""
        return any(member.loses for member in self.members)

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
            "loses": self.loses,
        }


@dataclass(frozen=True)
class CandidateScore:
    """A cause or free-form error that the search considered."""

    name: str  # name of the cause or free-form error
    parameters: tuple[str, ...]  # parameters of the cause; empty for a free-form error
    probability: Share  # that it is larger than the background of small errors
    evidence: Share  # log Bayes factor for that, conditional on the other causes found
    words: str = ""  # the cause without its size, a clause

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that earlier versions computed, with fixed values."""
        return {"p_value": None, "cv_rms_mm": None, "plausible": True}
