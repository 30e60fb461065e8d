"""Causes and curves read from the posterior, and base parameters far beyond their tolerances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtr

from orthoglide.effects import free_form_words
from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.free_form_place import Range
from orthoglide.explanation.full_posterior import FullPosterior
from orthoglide.fit import Estimate
from orthoglide.fit.problem import CERTAIN_SIGMAS, MAX_TOLERANCES
from orthoglide.geometry import Array
from orthoglide.numerals import compact
from orthoglide.ordering import RELATIVE_MARGIN, descending, ranked
from orthoglide.result import CandidateScore, Cause, Curve, Explanation, Located

CREDIBLE = 0.95
"""Probability that a credible set contains the true cause."""


@dataclass(frozen=True, eq=False, repr=False)
class CredibleSets:
    """All active causes and located errors, and what is reported if there are none."""

    effects: tuple[Cause, ...] = ()  # with names, the one that the fit needs most first
    located: tuple[Located, ...] = ()  # without names, in the same order
    candidates: tuple[CandidateScore, ...] = ()  # nearest to being active, most probable first
    # if none is active, the causes of which one alone may explain the readings, with all other
    # errors within `SOUND_BACKGROUND`: a credible set of 95 %
    alone: tuple[Explanation, ...] = ()
    # if none is active: the most probable causes, each estimated as the only one, and free-form
    # errors that are more probable than not
    possible: tuple[Explanation | Curve, ...] = ()

    @property
    def names(self) -> frozenset[str]:
        """Names of all causes and free-form errors in the credible sets."""
        explanations = [one for cause in self.effects for one in cause.explanations]
        causes = {name for one in explanations for name in (one.name, *one.families)}
        places = {one.name for located in self.located for one in located.members}
        return frozenset(causes | places | {n for one in self.located for n in one.resembling})


def smallest_count(odds: Array, probability: float) -> int:
    """Return the smallest count of ``odds`` (sorted, largest first) that sum to ``probability``."""
    return int(np.searchsorted(np.cumsum(odds), probability * (1 - RELATIVE_MARGIN))) + 1


def pool_variants(odds: Array, errors: Mapping[int, FreeForm]) -> tuple[Array, dict[int, str]]:
    """Sum the probabilities of free-form errors that have the same part and kind (jump, bump or
    curve) and assign the sum to the most probable.

    Args:
        odds: probabilities of groups in one credible set ``(groups,)``.
        errors: free-form errors by group.

    Returns:
        These probabilities ``(groups,)``, and for each pooled jump or bump a clause with the 95 %
        range of its moments or places.
    """
    variants = dict[tuple[str, bool, bool], list[int]]()
    for k in descending(odds):
        if odds[k] > 0 and (error := errors.get(k)):
            kind = error.jump is not None, error.bump is not None
            variants.setdefault((error.location_key, *kind), []).append(k)
    pooled, ranges = odds.copy(), dict[int, str]()
    for of_part in variants.values():
        first, *others = of_part
        pooled[first], pooled[others] = odds[of_part].sum(), 0.0
        if not errors[first].is_local:
            continue
        credible = of_part[: smallest_count(odds[of_part], CREDIBLE * pooled[first])]
        spots = dict(sorted(spot for k in credible for spot in _spots(errors[k])))
        if len(spots) > len(_spots(errors[first])):
            start, *_, end = spots.values()
            ranges[first] = f" (from {start} to {end})"
    return pooled, ranges


def _spots(error: FreeForm) -> list[tuple[float, str]]:
    """Return the moment, the place or the ends of a local error, as numbers and in words."""
    if error.jump is None:
        return [(at := error.bump or 0.0, f"{compact(at * 1e3, 3)} mm")]
    if not error.is_step:
        return [(sum(error.jump) / 2, error.spot)]
    words = (f"{travel} mm" for travel in error.travels_of_step)
    return list(zip(error.jump, words, strict=True))


def curve_of(
    error: FreeForm, probability: float, stroke: Range, mean: Array, covariance: Array
) -> Curve:
    """Return a free-form error as a curve.

    Args:
        error: the free-form error.
        probability: given all other causes.
        stroke: of the machine, metres.
        mean: of its coefficients ``(k,)``, in their prior standard deviations.
        covariance: of these ``(k, k)``.
    """
    u, functions = error.sampled
    functions = functions * error.prior_sd
    if error.is_step:
        covariance = np.diag([covariance[0, 0], mean[0] ** 2 + covariance[0, 0]])
    low, high = error.interval(stroke)
    value, covariance = functions @ mean, functions @ covariance @ functions.T
    legs = error.names.legs
    return Curve(
        name=error.name,
        leg=legs[error.leg] if error.leg >= 0 else None,
        part=error.part,
        direction=error.direction or None,
        against=error.against,
        short_waves=error.short_waves,
        by_leg=legs[error.command_drive] if error.against == "command" else None,
        setup=error.setup or None,
        probability=probability,
        unit="mrad" if error.is_rotation else "mm",
        description=error.words,
        at=low + (u + 1) / 2 * (high - low),
        of_dial=error.of_dial,
        of_machine=error.of_machine,
        place=error,
        coefficients=mean,
        **_values(error, value, covariance),
    )


def _values(error: FreeForm, value: Array, covariance: Array) -> dict[str, Any]:
    """Return the fields of a curve that follow from its values ``(k,)`` and their covariance
    ``(k, k)``, SI.
    """
    size = error.size(value)
    return {
        "value": value,
        "sigma": np.sqrt(np.maximum(np.diag(covariance), 0.0)),
        "size": size,
        "size_words": free_form_words.signed_size_words(error, size),
        "size_sigma": error.size_sigma(value, covariance),
    }


def averaged_over_periods(curve: Curve, posterior: FullPosterior, member: int) -> Curve:
    """Return the curve of a wave, averaged over all periods that it may have in the place of an
    active group: their differences are part of its standard deviation. A curve that is not a wave
    is returned unchanged.
    """
    if curve.place.period is None:
        return curve
    odds, u = posterior.alternatives.probabilities(member), curve.place.sampled[0]
    key = curve.place.location_key
    weights, values, covariances = list[float](), list[Array](), list[Array]()
    for k, group in enumerate(posterior.mixture.linear.groups):
        wave, index = group.source, group.coefficients
        if group.free_form and odds[k] > 0 and wave.period and wave.location_key == key:
            mean, covariance = posterior.alternatives.moments(member, k, index)
            functions = wave.prior_sd * np.stack(wave.kernel.functions(u), axis=1)
            functions -= functions.mean(axis=0)
            weights.append(float(odds[k]))
            values.append(functions @ mean[index])
            covariances.append(functions @ covariance @ functions.T)
    share = np.array(weights) / sum(weights)
    value = share @ np.stack(values)
    differences = np.stack(values) - value
    covariance = np.tensordot(share, np.stack(covariances), 1)
    covariance += (differences.T * share) @ differences
    return replace(curve, **_values(curve.place, value, covariance))


def probable_places(posterior: FullPosterior, least: float) -> list[Curve]:
    """Return the free-form errors that are more probable than ``least``, each estimated as the only
    one, most probable first; variants at one place count together.
    """
    mixture, by_place, by_group = posterior.mixture, Counter[str](), Counter[int]()
    groups, stroke = mixture.linear.groups, posterior.before.problem.machine.geometry.stroke
    for state, weight in mixture.weights.items():
        active = [k for k, _ in state if groups[k].free_form]
        by_group.update(dict.fromkeys(active, float(weight.sum())))
        keys = {groups[k].source.location_key for k in active}
        by_place.update(dict.fromkeys(keys, float(weight.sum())))
    curves, keys = list[Curve](), set[str]()
    for k, _ in by_group.most_common():
        error, index = groups[k].source, groups[k].coefficients
        key, probability = error.location_key, min(by_place[error.location_key], 1.0)
        if key not in keys and probability > least:
            moments = mixture.likeliest_moments(mixture.child((), k), index)
            mean, covariance = moments[0][index], moments[1]
            curves.append(curve_of(error, probability, stroke, mean, covariance))
        keys.add(key)
    return ranked(curves, lambda curve: curve.probability)


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


def fitted_beyond_tolerance(estimate: Estimate) -> tuple[Cause, ...]:
    """Return, as causes, the fitted parameters that exceed three tolerances by at least two
    standard deviations, except zeros of drives and parameters from an earlier calibration.
    """
    problem, values, sigmas = estimate.problem, estimate.values, estimate.sigmas
    deviation = np.abs(problem.without_common_error(estimate.x))
    catalogue, causes = problem.machine.catalogue, list[Cause]()
    margin = CERTAIN_SIGMAS * np.sqrt(np.diag(estimate.covariance))
    for k in np.flatnonzero(problem.is_implausible(estimate.x, margin)):
        name, limit = problem.names[k], MAX_TOLERANCES * problem.unknowns[k].tolerance
        if catalogue.effect_of(name).controller == "zero":
            continue
        explanation = Explanation(
            str(name),
            (str(name),),
            float(ndtr((deviation[k] - limit) / sigmas[name])),
            {str(name): values[name]},
            {str(name): sigmas[name]},
            catalogue,
            estimate.machine.values,
        )
        causes.append(Cause(explanation))
    return tuple(causes)


def _beyond_tolerance(
    posterior: FullPosterior, index: Sequence[int], combined: Sequence[tuple[str, Array]]
) -> list[Cause]:
    """Return those combinations of base parameters that are certainly far beyond tolerance.

    Args:
        posterior: of the full model.
        index: of the parameters, all of one effect.
        combined: name and weights ``(k,)`` of each combination.
    """
    linearised, problem = posterior.linearised, posterior.before.problem
    machine, count = problem.machine, len(problem.names)
    mean = problem.without_common_error(posterior.mean[:count] * linearised.units[:count])[index]
    units = linearised.units[index]
    covariance, _ = posterior.averaged_covariances
    covariance = covariance[np.ix_(index, index)] * units * units[:, None]
    limit, causes = MAX_TOLERANCES * machine.tolerance(problem.names[index[0]]), list[Cause]()
    for name, weights in combined:
        value, sigma = float(weights @ mean), float(np.sqrt(weights @ covariance @ weights))
        if abs(value) - CERTAIN_SIGMAS * sigma < limit:
            continue
        explanation = Explanation(
            str(name),
            (str(name),),
            float(ndtr((abs(value) - limit) / sigma)),
            {str(name): value},
            {str(name): sigma},
            posterior.machine.catalogue,
            posterior.machine_values(posterior.mean),
        )
        causes.append(Cause(explanation))
    return causes
