"""Base parameters that are certainly far beyond tolerance, as causes of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import ndtr

from orthoglide.explanation.causes import Cause, Explanation
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit.problem import MAX_TOLERANCES
from orthoglide.geometry import Array

_CERTAIN_SIGMAS = 2.0  # standard deviations by which a parameter must exceed its limit


def far_base_causes(posterior: FullPosterior) -> Iterator[Cause]:
    """Yield base parameters certainly far beyond tolerance, zeros of drives excepted.

    Parts of one kind on all legs are one cause where they are off alike: rods cut to one
    length, or measured by one calliper. Of these and of single parts the fewer are reported.
    """
    problem = posterior.before.problem
    catalogue, effects = problem.machine.catalogue, [n.effect for n in problem.names]
    for effect in dict.fromkeys(effects):
        if catalogue[effect].controller == "zero":
            continue
        at = [k for k, name in enumerate(problem.names) if name.effect == effect]
        one_each = np.eye(len(at))
        single = [(problem.names[k], one_each[i]) for i, k in enumerate(at)]
        found = _beyond_tolerance(posterior, at, single)
        members = {problem.names[k] for k in at}
        for pattern, weights in catalogue.structured_members(effect).items():
            if pattern.member == "common" and set(weights) == members and len(at) > 1:
                mean = np.full(len(at), 1 / len(at))
                alike = [(pattern, mean), *((n, w - mean) for n, w in single)]
                together = _beyond_tolerance(posterior, at, alike)
                if together and together[0].name == pattern and len(together) < len(found):
                    found = together
        yield from found


def _beyond_tolerance(
    posterior: FullPosterior, at: Sequence[int], combined: Sequence[tuple[str, Array]]
) -> list[Cause]:
    """Return those combinations of base parameters that are certainly far beyond tolerance.

    Args:
        posterior: of the readings.
        at: indices of the parameters, all of one effect.
        combined: each with its name and its weights of these ``(k,)``.
    """
    about, problem, known = posterior.linearised, posterior.before.problem, posterior.moments
    machine, count = problem.machine, len(problem.names)
    names, values, _ = posterior.machine_parameters(posterior.mean)
    past = problem.without_entered_mean(known.mean[:count] * about.units[:count])[at]
    scale = about.units[at]
    spread = known.covariance[np.ix_(at, at)] * scale * scale[:, None]
    most, found = MAX_TOLERANCES * machine.tolerance(problem.names[at[0]]), list[Cause]()
    for name, weights in combined:
        value, sigma = float(weights @ past), float(np.sqrt(weights @ spread @ weights))
        if abs(value) - _CERTAIN_SIGMAS * sigma < most:
            continue
        shown = about.rows[:, at] @ ((weights > 0) * value / scale)
        one = Explanation(
            str(name),
            (str(name),),
            float(ndtr((abs(value) - most) / sigma)),
            {str(name): value},
            {str(name): sigma},
            dict(zip(names, values.tolist(), strict=True)),
            shown - about.nuisance.explained_residual(shown),
            posterior.machine.catalogue,
        )
        found.append(Cause(one, (), ()))
    return found
