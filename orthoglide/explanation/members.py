"""Each of a class of places as if it were the right one: what it says of all coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects.places import Place
from orthoglide.effects.wording import cause_short
from orthoglide.explanation.alternatives import Alternatives
from orthoglide.explanation.causes import Located
from orthoglide.explanation.everything import FullPosterior
from orthoglide.explanation.free import by_places
from orthoglide.fit.problem import Factor
from orthoglide.geometry import Array
from orthoglide.ordering import descending
from orthoglide.prediction import Seen


@dataclass(frozen=True, eq=False)
class Member:
    """One place, or cause that it resembles, with all else that was found."""

    words: str  # where it is and how, as a clause
    # whether other readings of the machine show it: not what comes with time, or is own to a dial
    # that was read
    lasts: bool
    probability: float  # that it is this one, all else that was found given
    machine: Mapping[str, float]  # all parameters of the calibrated machine with it, SI
    mean: Array  # of the coefficients that count (k,), in their units
    covariance: Array  # of these (k, k)


@dataclass(frozen=True, eq=False)
class Members:
    """The likeliest of a class."""

    posterior: FullPosterior  # that they are from
    each: tuple[Member, ...]  # the likeliest first
    at: NDArray[np.intp]  # coefficients that count: all parameters, then those of the places (k,)
    places: tuple[Place, ...]  # that stand in any of the explanations

    @classmethod
    def of(cls, posterior: FullPosterior, located: Located, most: int) -> Members:
        """The likeliest of a class of places, ``most`` at most, by the posterior that it was read
        from.
        """
        about, groups = posterior.about, posterior.mixture.linear.groups
        instead = Alternatives(posterior.mixture)
        odds = instead.of(located.group)[:-1]
        names = {curve.name for curve in located.members} | {*located.resembling}
        chosen = [k for k in descending(odds) if groups[k].name in names]
        chosen = chosen[:most]
        by_name = {p.name: p for p in about.places}
        standing = {groups[g].name for k in chosen for g, _ in instead.state(located.group, k)}
        places = tuple(p for p in about.places if p.name in standing)
        at = np.concatenate([np.arange(about.known), *map(about.coefficients, places)])
        each = []
        for k in chosen:
            name = groups[k].name
            mean, covariance = instead.moments(located.group, k, at)
            parameters, values, _ = posterior.machine_with(mean)
            found = by_name.get(name)
            words = found.words if found else cause_short(posterior.machine.catalogue, name)
            machine = dict(zip(parameters, values.tolist(), strict=True))
            lasts = found is None or _lasts(found)
            each.append(Member(words, lasts, float(odds[k]), machine, mean[at], covariance))
        return cls(posterior, tuple(each), at, places)

    def rows(self, factor: Factor) -> tuple[Array, Seen]:
        """Readings yet to be taken of the machine as it is in the last campaign, by the
        coefficients ``(n, k)``, and what their instruments see.

        What does not last is not in them.
        """
        posterior, fit = self.posterior, self.posterior.after
        machine, catalogue = fit.problem.machine, fit.problem.machine.catalogue
        values = catalogue.of_machine(fit.problem.values(fit.problem.last, fit.x))
        names, _, weights = posterior.machine_with(posterior.mean)
        kept = [k for k, name in enumerate(names) if name in catalogue.motions]
        here = factor.linearise(machine.model, values, [names[k] for k in kept])
        rows = here.jacobian @ weights[kept]
        again = [p for p in self.places if _lasts(p)]
        for place, columns in zip(
            again, by_places(factor, machine.model, values, again), strict=True
        ):
            rows[:, posterior.about.coefficients(place)] = columns
        return rows[:, self.at], here.seen


def _lasts(place: Place) -> bool:
    return not (place.of_dial or place.against == "time")
