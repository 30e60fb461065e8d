"""Names of parameters, weak directions and lists in words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from orthoglide.effects import BASE_FAMILIES
from orthoglide.numerals import compact, signed

if TYPE_CHECKING:
    from orthoglide.fit import WeakDirection


def parameter_words(name: str) -> str:
    """``axis_tilt.y.z`` as ``axis tilt of leg y toward z``."""
    plain, _, campaign = name.partition("@")
    family, _, member = plain.partition(".")
    words, place = family.replace("_", " "), member.split(".")
    where = f" ({campaign})" if campaign else ""
    if family.startswith("gauge_"):
        return f"{words} of setup {member}{where}"
    if place[0] not in ("x", "y", "z"):
        return f"{words}, {member.replace('.', ' ')}{where}"
    if len(place) == 2 and place[1] in ("x", "y", "z"):
        return f"{words} of leg {place[0]} toward {place[1]}{where}"
    tail = {"a": " about its axis", "b": " about its pivots", "sin": ", sine", "cos": ", cosine"}
    return f"{words} of leg {place[0]}{tail.get('.'.join(place[1:]), '')}{where}"


def weak_sentences(weak: Iterable[WeakDirection]) -> list[str]:
    """Weak directions for somebody who never saw an eigenvector; alike ones in one sentence."""
    every = list(weak)
    legs = [_offset_and_length(w) for w in every]
    alike = [w for w, leg in zip(every, legs, strict=True) if leg]
    said = [_general(w) for w, leg in zip(every, legs, strict=True) if not leg]
    if alike:
        said.insert(0, _together(alike, sorted(leg for leg in legs if leg)))
    return said


def _offset_and_length(weak: WeakDirection) -> str:
    """The leg (and campaign) whose offset and length change together; empty for anything else."""
    if len(weak.parameters) != 2 or len({share > 0 for share in weak.parameters.values()}) != 1:
        return ""
    (family, leg), (other, same) = (name.split(".", 1) for name in weak.parameters)
    return leg if {family, other} == set(BASE_FAMILIES) and leg == same else ""


def _together(weak: list[WeakDirection], legs: list[str]) -> str:
    widest = max(weak, key=lambda w: w.sigma)
    words = [leg.replace("@", " of ") for leg in legs]
    text = (
        f"The readings cannot tell the joint offset from the leg length of leg {listed(words)}: "
        f"where both grow alike, by as much as {compact(widest.sigma, 2)} {widest.unit} (one "
        f"sigma), hardly a reading changes. Their difference is what is seen."
    )
    return text + _narrowed(widest)


def _general(weak: WeakDirection) -> str:
    names = listed([parameter_words(name) for name in weak.parameters])
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


def sentence(text: str) -> str:
    """With a capital and a full stop; a parameter's name keeps its small letter."""
    first = text.partition(" ")[0]
    capital = text if "_" in first or "." in first else text[:1].upper() + text[1:]
    return capital if capital.endswith("?") else f"{capital}."


def listed(parts: Iterable[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    every = list(parts)
    if len(every) < 2:
        return "".join(every)
    return f"{', '.join(every[:-1])} and {every[-1]}"
