"""Each of a class of places as if it were the right one: what it says of all coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.wording import cause_short
from orthoglide.explanation.alternatives import Alternatives
from orthoglide.explanation.causes import Located
from orthoglide.explanation.free_form import free_form_columns_of_factor
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit.problem import Factor
from orthoglide.geometry import Array
from orthoglide.ordering import descending
from orthoglide.prediction import ReadingPoses


@dataclass(frozen=True, eq=False)
class ClassMember:
    """One place, or cause that it resembles, with all else that was found."""

    words: str  # where it is and how, as a clause
    # whether other readings of the machine show it: not what comes with time, or is own to a dial
    # that was read
    permanent: bool
    probability: float  # that it is this one, all else that was found given
    machine: Mapping[str, float]  # all parameters of the calibrated machine with it, SI
    mean: Array  # of the coefficients that count (k,), in their units
    covariance: Array  # of these (k, k)


@dataclass(frozen=True, eq=False)
class ClassMembers:
    """The likeliest of a class."""

    posterior: FullPosterior  # that they are from
    members: tuple[ClassMember, ...]  # the likeliest first
    coefficients: NDArray[
        np.intp
    ]  # coefficients that count: all parameters, then those of the places (k,)
    free_form_errors: tuple[FreeForm, ...]  # that stand in any of the explanations

    @classmethod
    def from_posterior(cls, posterior: FullPosterior, located: Located, most: int) -> ClassMembers:
        """The likeliest of a class of places, ``most`` at most, by the posterior that it was read
        from.
        """
        about, groups = posterior.linearised, posterior.mixture.linear.groups
        instead = Alternatives(posterior.mixture)
        odds = instead.probabilities(located.group)[:-1]
        names = {curve.name for curve in located.members} | {*located.resembling}
        chosen = [k for k in descending(odds) if groups[k].name in names]
        chosen = chosen[:most]
        by_name = {p.name: p for p in about.free_form_errors}
        standing = {groups[g].name for k in chosen for g, _ in instead.state(located.group, k)}
        places = tuple(p for p in about.free_form_errors if p.name in standing)
        at = np.concatenate([np.arange(about.parameter_count), *map(about.coefficients, places)])
        each = []
        for k in chosen:
            name = groups[k].name
            mean, covariance = instead.moments(located.group, k, at)
            parameters, values, _ = posterior.machine_parameters(mean)
            found = by_name.get(name)
            words = found.words if found else cause_short(posterior.machine.catalogue, name)
            machine = dict(zip(parameters, values.tolist(), strict=True))
            lasts = found is None or _is_permanent(found)
            each.append(ClassMember(words, lasts, float(odds[k]), machine, mean[at], covariance))
        return cls(posterior, tuple(each), at, places)

    def rows(self, factor: Factor) -> tuple[Array, ReadingPoses]:
        """Readings yet to be taken of the machine as it is in the last campaign, by the
        coefficients ``(n, k)``, and what their instruments see.

        What does not last is not in them.
        """
        posterior, fit = self.posterior, self.posterior.after
        machine, catalogue = fit.problem.machine, fit.problem.machine.catalogue
        values = catalogue.machine_values(fit.problem.values(fit.problem.last_factor, fit.x))
        names, _, weights = posterior.machine_parameters(posterior.mean)
        kept = [k for k, name in enumerate(names) if name in catalogue.motions]
        here = factor.linearise(machine.model, values, [names[k] for k in kept])
        rows = here.jacobian @ weights[kept]
        again = [p for p in self.free_form_errors if _is_permanent(p)]
        for place, columns in zip(
            again, free_form_columns_of_factor(factor, machine.model, values, again), strict=True
        ):
            rows[:, posterior.linearised.coefficients(place)] = columns
        return rows[:, self.coefficients], here.reading_poses


def _is_permanent(place: FreeForm) -> bool:
    return not (place.of_dial or place.against == "time")
