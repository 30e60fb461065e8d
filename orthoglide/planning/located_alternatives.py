"""The alternatives of one located error, and the derivatives of planned readings by them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.wording import cause_short
from orthoglide.explanation import FullPosterior
from orthoglide.explanation.free_form import free_form_columns_of_factor
from orthoglide.explanation.linear_model import Group
from orthoglide.fit.factors import Factor
from orthoglide.geometry import Array
from orthoglide.ordering import descending
from orthoglide.prediction import ReadingPoses
from orthoglide.result import Located


@dataclass(frozen=True, eq=False)
class LocatedAlternative:
    """A free-form error of a credible set, or a cause that resembles it, given all other causes."""

    words: str  # its place and form, as a clause
    permanent: bool  # whether later readings show it: it depends neither on time nor on a dial
    probability: float  # given all other causes
    machine: Mapping[str, float]  # all parameters of the calibrated machine with it, SI
    mean: Array  # of the coefficients of `LocatedAlternatives` (k,), in their units
    covariance: Array  # of these (k, k)


@dataclass(frozen=True, eq=False)
class LocatedAlternatives:
    """The likeliest alternatives of one located error, of which one is true."""

    posterior: FullPosterior  # that they are from
    members: tuple[LocatedAlternative, ...]  # most probable first
    coefficients: NDArray[np.intp]  # of all parameters, then of the free-form errors (k,)
    free_form_groups: tuple[Group, ...]  # that are active with any of the members

    @classmethod
    def from_posterior(
        cls, posterior: FullPosterior, located: Located, max_members: int
    ) -> LocatedAlternatives:
        """Return the likeliest alternatives of a located error, ``max_members`` at most."""
        linearised, groups = posterior.linearised, posterior.mixture.linear.groups
        alternatives = posterior.alternatives
        probabilities = alternatives.probabilities(located.group)[:-1]
        names = {curve.name for curve in located.members} | {*located.resembling}
        chosen = [k for k in descending(probabilities) if groups[k].name in names][:max_members]
        states = [alternatives.state(located.group, k) for k in chosen]
        active = sorted({g for state in states for g, _ in state})
        curves = tuple(groups[g] for g in active if groups[g].free_form)
        spans = (curve.coefficients for curve in curves)
        coefficients = np.concatenate([np.arange(linearised.parameter_count), *spans])
        members = []
        for k in chosen:
            mean, covariance = alternatives.moments(located.group, k, coefficients)
            if groups[k].free_form:
                words, permanent = groups[k].source.words, _is_permanent(groups[k].source)
            else:
                words, permanent = cause_short(posterior.machine.catalogue, groups[k].name), True
            members.append(LocatedAlternative(
                words, permanent, float(probabilities[k]), posterior.machine_values(mean),
                mean[coefficients], covariance,
            ))  # fmt: skip
        return cls(posterior, tuple(members), coefficients, curves)

    def linearise(self, factor: Factor) -> tuple[Array, ReadingPoses]:
        """Return the derivative ``(n, k)`` of planned readings by the coefficients, and the poses
        of their instruments.

        The machine is that of the last campaign, without the errors that are not permanent.
        """
        posterior, fit = self.posterior, self.posterior.after
        machine, catalogue = fit.problem.machine, fit.problem.machine.catalogue
        values = catalogue.machine_values(fit.problem.values(fit.problem.last_factor_index, fit.x))
        names, weights = posterior.machine_weights
        in_catalogue = [k for k, name in enumerate(names) if name in catalogue.motions]
        linearised = factor.linearise(machine.model, values, [names[k] for k in in_catalogue])
        rows = linearised.jacobian @ weights[in_catalogue]
        curves = [group for group in self.free_form_groups if _is_permanent(group.source)]
        errors = [group.source for group in curves]
        blocks = free_form_columns_of_factor(factor, machine.model, values, errors)
        for group, columns in zip(curves, blocks, strict=True):
            rows[:, group.coefficients] = columns
        return rows[:, self.coefficients], linearised.reading_poses


def _is_permanent(error: FreeForm) -> bool:
    return not (error.of_dial or error.against == "time")
