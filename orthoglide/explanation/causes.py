"""Active causes, located errors and their credible sets, as data."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from orthoglide.effects.free_form import FreeForm
from orthoglide.geometry import Array
from orthoglide.numerals import compact
from orthoglide.result import CandidateScore, DataRival, Explanation
from orthoglide.result.findings import CredibleSet


@dataclass(frozen=True, eq=False, repr=False)
class Cause(CredibleSet["Curve"]):
    """One active cause, with its credible set."""

    chosen: Explanation  # the most probable of the set
    rivals: tuple[Explanation, ...]  # others, which move the tool differently; most probable first
    same: tuple[Explanation, ...]  # others, which move the tool equally: other names of the cause
    places: tuple[Curve, ...] = ()  # free-form errors of the set, less probable than the causes
    data: tuple[DataRival, ...] = ()  # data faults of the set, most probable first

    @property
    def all_parameters(self) -> tuple[str, ...]:
        """Parameters of the whole credible set."""
        return tuple(name for one in self.explanations for name in one.parameters)


@dataclass(frozen=True, eq=False, repr=False)
class Curve:
    """A free-form error with its curve."""

    place: FreeForm  # its place and form
    probability: float  # given all other causes
    at: Array  # abscissa (k,): travel or command (metres), or time (seconds)
    # SI (k,); without its mean, which may belong to the zeros, unless it is lost motion or local
    value: Array
    sigma: Array  # of the values, SI (k,)

    def __repr__(self) -> str:
        return f"<{self.name}, probability {self.probability:.2f}: {self.size_words}>"

    @property
    def name(self) -> str:
        """Name of the free-form error."""
        return self.place.name

    @property
    def words(self) -> str:
        """Clause that says what is wrong, with its size."""
        return f"{self.place.words}, by {self.size_words}"

    @property
    def size(self) -> float:
        """Size of the error, SI.

        It is the largest value of a bump or jump, the range after a reversal, the root mean square
        difference of both approaches, and else the root mean square about the mean.
        """
        if self.place.is_local:
            return float(np.abs(self.value).max())
        if self.place.against == "approach":
            return float(np.sqrt(np.mean(self.value**2)))
        if self.place.against == "reversal":
            return float(np.ptp(self.value))
        return float(np.std(self.value))

    @property
    def unit(self) -> str:
        """Unit of the reports: millimetres, or milliradians for rotations."""
        return "mrad" if self.place.is_rotation else "mm"

    @property
    def size_words(self) -> str:
        """Size with its unit, marked if it is a root mean square."""
        whole = self.place.depends_on_approach or self.place.is_local
        return f"{compact(self.size * 1e3, 2)} {self.unit}{'' if whole else ' rms'}"


@dataclass(frozen=True, eq=False, repr=False)
class Located:
    """A free-form error: a class of places that the readings cannot tell apart."""

    members: tuple[Curve, ...]  # most probable first
    resembling: tuple[str, ...]  # causes of the catalogue in the same credible set
    probability: float  # that it is one of the members, given all other causes
    group: int  # active group of the best state, to which the members are alternatives
    ruled_out: tuple[str, ...] = ()  # causes that move the same as the first member, not in the set
    data: tuple[DataRival, ...] = ()  # data faults in the same credible set, most probable first

    def __repr__(self) -> str:
        return f"<Located {', '.join(map(repr, self.members))}>"

    @property
    def name(self) -> str:
        """Name of the most probable member."""
        return self.members[0].name

    def in_machine(self, known: Container[str]) -> tuple[str, tuple[str, ...]]:
        """Return the name of the class in an error budget, and its parameters in a machine.

        Members that the machine does not contain are left out: those of dials, lost motion,
        improbable ones.
        """
        effects = [curve.place.effect for curve in self.members]
        found = [effect for effect in effects if effect.name in known]
        name = (found or effects)[0].name
        return name, tuple(str(part) for effect in found for part in effect.motions)


@dataclass(frozen=True, eq=False, repr=False)
class CredibleSets:
    """All active causes and located errors, and what is reported if there are none."""

    causes: tuple[Cause, ...]  # with names, the one that the fit needs most first
    located: tuple[Located, ...]  # without names, in the same order
    candidate_scores: tuple[CandidateScore, ...]  # of the nearest groups, most probable first
    # if none is active: the credible set of single causes on an otherwise sound machine
    single_causes: tuple[Explanation, ...] = ()
    # if none is active: the most probable causes, each estimated as the only one
    possible_causes: tuple[Explanation, ...] = ()

    @property
    def names(self) -> frozenset[str]:
        """Names of all causes and free-form errors in the credible sets."""
        causes = {one.name for cause in self.causes for one in cause.explanations}
        places = {one.name for located in self.located for one in located.members}
        return frozenset(causes | places | {n for one in self.located for n in one.resembling})
