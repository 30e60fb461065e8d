"""What may stand out of the background: causes with a name, places without, their credible sets."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.effects import Catalogue
from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.wording import cause_words
from orthoglide.geometry import Array
from orthoglide.numerals import compact
from orthoglide.parameters import split_campaign
from orthoglide.result import CandidateScore, DataRival


@dataclass(frozen=True, eq=False, repr=False)
class Explanation:
    """One cause of the catalogue, all else that was found given."""

    name: str  # of the cause
    parameters: tuple[str, ...]  # that it consists of, as `with_free` takes them
    probability: float  # all else given
    values: Mapping[str, float]  # of its parameters, SI
    sigmas: Mapping[str, float]  # of these
    machine: Mapping[str, float]  # all parameters of the machine with this cause, SI
    shown: Array  # its part of the readings, datums fitted (n,), metres
    catalogue: Catalogue  # that it belongs to

    def __repr__(self) -> str:
        return f"<{self.name}, probability {self.probability:.2f}: {self.words}>"

    @property
    def unit(self) -> str:
        """Of its parameters, as files name it."""
        return self.catalogue.effect_of(self.name).unit.name

    @property
    def words(self) -> str:
        """What is wrong, with size and sign, as a clause; of each campaign if these differ."""
        if split_campaign(self.name)[1]:
            return cause_words(self.catalogue, self.name, dict(self.values))
        each = dict[str, dict[str, float]]()
        for name, value in self.values.items():
            parameter = self.catalogue.parameter(name)
            each.setdefault(parameter.campaign, {})[parameter.plain] = value
        told = [
            cause_words(self.catalogue, self.name, values)
            + f" ({campaign})" * bool(campaign and len(each) > 1)
            for campaign, values in each.items()
        ]
        return ", and ".join(told)

    @property
    def exceeds_uncertainty(self) -> bool:
        """Whether anything of it is larger than its uncertainty: else it explains nothing."""
        return any(abs(value) > self.sigmas[n] for n, value in self.values.items())

    @property
    def look_at(self) -> str:
        """Where to look for it on the machine."""
        return self.catalogue.effect_of(self.name).look_at

    @property
    def estimate_in_unit(self) -> tuple[float, float] | None:
        """Value and sigma in its unit; ``None`` where it has several parameters.

        Of one that campaigns have for themselves: the last one's.
        """
        if len({self.catalogue.parameter(n).plain for n in self.parameters}) != 1:
            return None
        name, si = self.parameters[-1], self.catalogue.effect_of(self.name).unit.si
        return self.values[name] / si, self.sigmas[name] / si


@dataclass(frozen=True, eq=False, repr=False)
class Cause:
    """One cause that stands out, with its credible set."""

    chosen: Explanation  # the most probable of the set
    # the rest of the set that moves the tool otherwise, most probable first
    rivals: tuple[Explanation, ...]
    # what moves the tool alike too: the same cause under another name
    same: tuple[Explanation, ...]
    # places of the set, of which it is less likely than by name
    places: tuple[Curve, ...] = ()
    # faults of the data of the set, most probable first
    data: tuple[DataRival, ...] = ()

    def __repr__(self) -> str:
        others = ", ".join(self.indistinguishable_from)
        return f"<Cause {self.name}: {self.chosen.words}{others and f'; or {others}'}>"

    @property
    def name(self) -> str:
        """Of the cause."""
        return self.chosen.name

    @property
    def parameters(self) -> tuple[str, ...]:
        """That it consists of."""
        return self.chosen.parameters

    @property
    def probability(self) -> float:
        """All else that was found given."""
        return self.chosen.probability

    @property
    def together(self) -> float:
        """Probability of the chosen one under any of its names, which share it."""
        return sum(one.probability for one in (self.chosen, *self.same))

    @property
    def explanations(self) -> tuple[Explanation, ...]:
        """The credible set."""
        return (self.chosen, *self.same, *self.rivals)

    @property
    def others(self) -> tuple[Explanation | Curve, ...]:
        """What else it may be, by name and by place."""
        return (*self.rivals, *self.places)

    @property
    def all_parameters(self) -> tuple[str, ...]:
        """Parameters of the whole credible set."""
        return tuple(name for one in self.explanations for name in one.parameters)

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        """Names of the rest of the set."""
        return tuple(one.name for one in (*self.same, *self.rivals))


@dataclass(frozen=True, eq=False, repr=False)
class Curve:
    """A place and the free function found there."""

    place: FreeForm  # where and how
    probability: float  # all else that was found given
    at: Array  # where the function is given: travel, command (metres) or time (seconds) (k,)
    # SI (k,); about its mean unless it is lost motion, as a level may belong to the zeros
    value: Array
    sigma: Array  # of the same, SI (k,)

    def __repr__(self) -> str:
        return f"<{self.name}, probability {self.probability:.2f}: {self.size_words}>"

    @property
    def name(self) -> str:
        """Of the place."""
        return self.place.name

    @property
    def words(self) -> str:
        """What is wrong there, with its size, as a clause."""
        return f"{self.place.words}, by {self.size_words}"

    @property
    def size(self) -> float:
        """How much it moves, SI: on an approach between the two sides, root mean square; after a
        reversal from the turn to the farthest; a bump at its top, and a jump as high as it is;
        else root mean square about its mean.
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
        """In which people read it: millimetres, or milliradians of what turns."""
        return "mrad" if self.place.is_rotation else "mm"

    @property
    def size_words(self) -> str:
        """Its size with its unit, and whether that is a root mean square."""
        whole = self.place.depends_on_approach or self.place.is_local
        return f"{compact(self.size * 1e3, 2)} {self.unit}{'' if whole else ' rms'}"


@dataclass(frozen=True, eq=False, repr=False)
class Located:
    """Something without a name: a class of places of which it is one."""

    members: tuple[Curve, ...]  # most probable first
    resembling: tuple[str, ...]  # causes of the catalogue in the same credible set
    probability: float  # that it is one of the members, all else that was found given
    group: int  # of the likeliest explanation, in whose place any of these may be
    # causes of the catalogue that move what the first member moves, and are none of the set
    ruled_out: tuple[str, ...] = ()
    # faults of the data in the same credible set, most probable first
    data: tuple[DataRival, ...] = ()

    def __repr__(self) -> str:
        return f"<Located {', '.join(map(repr, self.members))}>"

    @property
    def name(self) -> str:
        """Of the most probable place."""
        return self.members[0].name

    def in_machine(self, known: Container[str]) -> tuple[str, tuple[str, ...]]:
        """Name of the class in an error budget, and the parameters of its places in a machine that
        has these effects; places of a dial, of lost motion, and improbable ones, are none of them.
        """
        effects = [curve.place.effect for curve in self.members]
        found = [effect for effect in effects if effect.name in known]
        name = (found or effects)[0].name
        return name, tuple(str(part) for effect in found for part in effect.motions)


@dataclass(frozen=True, eq=False, repr=False)
class CredibleSets:
    """Everything that stands out of the background."""

    # with names, that first without which the readings are explained worst
    causes: tuple[Cause, ...]
    located: tuple[Located, ...]  # places without, in the same order
    candidate_scores: tuple[CandidateScore, ...]  # all that came near, most probable first
    # where nothing stands out of a background that shows: causes of which one would be behind it if
    # the rest of the machine were sound
    single_causes: tuple[Explanation, ...] = ()
    # where nothing stands out: the most probable causes, each as if it were there
    possible_causes: tuple[Explanation, ...] = ()

    @property
    def names(self) -> frozenset[str]:
        """Causes and places of all credible sets."""
        causes = {one.name for cause in self.causes for one in cause.explanations}
        places = {one.name for located in self.located for one in located.members}
        return frozenset(causes | places | {n for one in self.located for n in one.resembling})
