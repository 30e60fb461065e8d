"""Weak directions, sentences and lists in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from orthoglide.effects import CATALOGUE, Catalogue
from orthoglide.effects.wording import cause_short, parameter_words
from orthoglide.numerals import compact, signed
from orthoglide.observations.approach import SIDES_UNTOLD, TELL_SIDES
from orthoglide.ordering import best_of
from orthoglide.result import Action, Result, WeakDirection

_FEW = 2.0  # degrees of freedom
_SOUND = 0.05  # probability of what the base leaves, from which nothing more is told
_MANY = 0.1  # share of the readings
_KNOWN = 0.1  # of a gain, by which it may be off without a word

NOTHING_SHOWN = (
    "These readings show no error at all: either they were made up of a machine that has none, or "
    "the instruments read nothing."
)

MEANINGS: Mapping[str, str] = {
    "adequate": "nothing significant is left, and no single cause was added",
    "explained": "a cause was found, and nothing significant is left",
    "ambiguous": "explained, but other causes fit these readings as well",
    "located": "a place was found that no known shape explains, and nothing significant is left",
    "partial": "something was found, and something significant is left",
    "unexplained": "something significant is left, and nothing stands out",
}
"""What the verdict's words mean."""

WHICHEVER, PLATE = "on average, whichever of these it is", "on average, nothing if it is the plate"
"""Behind what it gains to put right one of several causes."""


def gain_words(action: Action) -> tuple[str, str]:
    """What it gains with its uncertainty, and whether that is a mean; empty where not known."""
    if not math.isfinite(action.gain):
        return "", ""
    size = compact(max(action.gain, 0.0) * 1e3, 2)
    if math.isfinite(action.gain_sigma) and action.gain_sigma > _KNOWN * action.gain:
        size = f"{size} ± {compact(action.gain_sigma * 1e3, 2)}"
    mean = PLATE if action.plate else WHICHEVER
    return f"{size} mm", f" {mean}" if action.whichever else ""


def weak_sentences(weak: Iterable[WeakDirection], catalogue: Catalogue = CATALOGUE) -> list[str]:
    """Weak directions for somebody who never saw an eigenvector; similar ones in one sentence."""
    every = list(weak)
    legs = [_offset_and_length(w, catalogue) for w in every]
    similar = [w for w, leg in zip(every, legs, strict=True) if leg]
    said = [_general(w, catalogue) for w, leg in zip(every, legs, strict=True) if not leg]
    if similar:
        said.insert(0, _together(similar, sorted(leg for leg in legs if leg)))
    return said


def _offset_and_length(weak: WeakDirection, catalogue: Catalogue) -> str:
    """The leg (and campaign) whose offset and length change together; empty for anything else."""
    names = [catalogue.parameter(name) for name in weak.parameters]
    same = len({(n.leg, n.campaign) for n in names}) == 1 and bool(names[0].leg)
    both = {n.effect for n in names} == set(catalogue.base) and len(names) == 2
    if not (same and both) or len({share > 0 for share in weak.parameters.values()}) != 1:
        return ""
    return f"{names[0].leg} of {names[0].campaign}" if names[0].campaign else names[0].leg


def _together(weak: list[WeakDirection], legs: list[str]) -> str:
    widest = best_of(weak, lambda w: w.sigma)
    text = (
        f"The readings cannot tell the joint offset from the leg length of leg {listed(legs)}: "
        f"where both grow by the same amount, by as much as {compact(widest.sigma, 2)} "
        f"{widest.unit} (one sigma), hardly a reading changes. Their difference is what is seen."
    )
    return text + _narrowed(widest)


def _general(weak: WeakDirection, catalogue: Catalogue) -> str:
    every = [parameter_words(catalogue.parameter(name)) for name in weak.parameters]
    names = listed(every)
    if len(weak.parameters) > 1:
        text = f"The readings cannot tell {names} apart"
    else:
        text = f"The readings hardly see the {names}"
    shares = listed([f"{signed(share, 2)} × {n}" for n, share in weak.parameters.items()])
    if weak.sigma == float("inf"):
        return f"{text}: nothing at all is seen of the combination {shares}.{_narrowed(weak)}"
    return (
        f"{text}: along {shares} the machine may move by {compact(weak.sigma, 2)} {weak.unit} (one "
        f"sigma) and hardly a reading changes.{_narrowed(weak)}"
    )


def _narrowed(weak: WeakDirection) -> str:
    if not weak.sigma_with_priors < 0.5 * weak.sigma:
        return ""
    return (
        f" The tolerances narrow this to {compact(weak.sigma_with_priors, 2)} {weak.unit}: that is "
        f"knowledge of how the machine was built, not of what was measured."
    )


def unshown_words(result: Result) -> str:
    """What these readings would not show, by effect, as a clause; empty where there is nothing."""
    if not (hidden := result.unseen.effects):
        return ""
    parts = (f"that {words}{f' ({listed(of)})' if of else ''}" for words, of in hidden)
    taken = listed(result.instruments.values())
    return (
        f"not visible to {taken} even at three times its tolerance, which is not absent: "
        f"{'; '.join(parts)}"
    )


_SIDES = {
    "fixed": "a probe comes from above alone, and of distances the sides are not known",
    "same": "every place was come to from the same side: come to some from the other as well",
    "unknown": f"{SIDES_UNTOLD}: {TELL_SIDES}",
}


def unvaried_words(result: Result) -> str:
    """That lost motion would not show, and why, as a clause; empty where it would."""
    if not (why := result.unseen.one_sided):
        return ""
    hidden = [name for name, needs in result.unseen.unvaried.items() if "approach" in needs]
    named = "; ".join(f"that {cause_short(result.catalogue, name)}" for name in hidden)
    return f"not visible either, which is not absent: {named}, as {_SIDES[why]}"


def sentence(text: str) -> str:
    """With a capital and a full stop; a parameter's name keeps its small letter."""
    first = text.partition(" ")[0]
    capital = text if "_" in first or "." in first else text[:1].upper() + text[1:]
    return capital if capital.endswith("?") else f"{capital}."


def dealt_with(result: Result) -> str:
    """How many faults of the data there were, and how many readings do not count for them: what
    these alone would show is in no verdict, and a reader of the first lines must know.
    """
    if not (count := len(result.blunders)):
        return ""
    faults = f"{count} fault{'s' if count > 1 else ''} in the data had to be dealt with first"
    aside = {row for one in result.blunders if one.excluded for row in one.rows_in_request}
    every = len(result.readings) + len(aside)
    if len(aside) < _MANY * every:
        return f"{faults}."
    return (
        f"{faults}: {len(aside)} of {every} readings do not count, and nothing is said of what "
        f"they alone would show."
    )


def listed(parts: Iterable[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    every = list(parts)
    if len(every) < 2:
        return "".join(every)
    return f"{', '.join(every[:-1])} and {every[-1]}"


def a_little(result: Result) -> bool:
    """Whether the base alone leaves so much that something small is wrong with everything."""
    return result.improved and result.before.scores.lack_of_fit_p < _SOUND


def none_left_over(result: Result) -> bool:
    """Whether what was fitted takes up all that the readings say."""
    return result.before.scores.dof < _FEW or result.after.scores.dof < 1.0


def meaning(result: Result) -> str:
    """What its verdict's word means; nothing is judged where too few readings are left over."""
    if result.word == "adequate" and none_left_over(result):
        return "no single cause was added, and too few readings are left over to judge what is left"
    return MEANINGS[result.word]
