"""Base parameters that are certainly far beyond their tolerances, as causes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import ndtr

from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit.problem import CERTAIN_SIGMAS, MAX_TOLERANCES
from orthoglide.geometry import Array
from orthoglide.result import Cause, Explanation


def far_base_causes(posterior: FullPosterior) -> Iterator[Cause]:
    """Yield base parameters certainly far beyond tolerance, except zeros of drives and what an
    earlier calibration found.

    If a common error of the parts on all legs (rods cut to one wrong length) needs fewer causes
    than single parts, it is reported in their place.
    """
    problem = posterior.before.problem
    catalogue = problem.machine.catalogue
    news = {k: problem.names[k] for k in np.flatnonzero(~problem.is_from_calibration).tolist()}
    for effect in dict.fromkeys(name.effect for name in news.values()):
        if catalogue[effect].controller == "zero":
            continue
        index = [k for k, name in news.items() if name.effect == effect]
        identity = np.eye(len(index))
        single = [(problem.names[k], identity[i]) for i, k in enumerate(index)]
        causes = _beyond_tolerance(posterior, index, single)
        members = {problem.names[k] for k in index}
        for pattern, weights in catalogue.structured_members(effect).items():
            if pattern.member == "common" and set(weights) == members and len(index) > 1:
                mean = np.full(len(index), 1 / len(index))
                combined = [(pattern, mean), *((n, w - mean) for n, w in single)]
                common = _beyond_tolerance(posterior, index, combined)
                if common and common[0].name == pattern and len(common) < len(causes):
                    causes = common
        yield from causes


def _beyond_tolerance(
    posterior: FullPosterior, index: Sequence[int], combined: Sequence[tuple[str, Array]]
) -> list[Cause]:
    """Return those combinations of base parameters that are certainly far beyond tolerance.

    Args:
        posterior: of the full model.
        index: of the parameters, all of one effect.
        combined: name and weights ``(k,)`` of each combination.
    """
    linearised, problem, moments = posterior.linearised, posterior.before.problem, posterior.moments
    machine, count = problem.machine, len(problem.names)
    names, values, _ = posterior.machine_parameters(posterior.mean)
    mean = problem.without_common_error(moments.mean[:count] * linearised.units[:count])[index]
    units = linearised.units[index]
    covariance = moments.covariance[np.ix_(index, index)] * units * units[:, None]
    limit, causes = MAX_TOLERANCES * machine.tolerance(problem.names[index[0]]), list[Cause]()
    for name, weights in combined:
        value, sigma = float(weights @ mean), float(np.sqrt(weights @ covariance @ weights))
        if abs(value) - CERTAIN_SIGMAS * sigma < limit:
            continue
        signature = linearised.rows.columns(index) @ ((weights > 0) * value / units)
        explanation = Explanation(
            str(name),
            (str(name),),
            float(ndtr((abs(value) - limit) / sigma)),
            {str(name): value},
            {str(name): sigma},
            signature - linearised.nuisance.explained_residual(signature),
            posterior.machine.catalogue,
            dict(zip(names, values.tolist(), strict=True)),
        )
        causes.append(Cause(explanation))
    return causes
