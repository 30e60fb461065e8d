"""What was found, in words: the sentence a result begins with, and the names of things."""

from __future__ import annotations

from collections.abc import Iterable

from orthoglide.effects import BASE_FAMILIES, family_of
from orthoglide.fit import Estimate, WeakDirection
from orthoglide.numerals import compact, decimals_for, signed

_HARDLY = 0.95  # of the deviations before: a fit that leaves more has not helped
_MOST_NAMED = 2
_TOLD = {"joint_offset": "joint offset", "leg_length": "leg length"}


def headline(estimate: Estimate) -> str:
    """The result in a sentence: what was found, what it gains, what is left."""
    return f"{found(estimate)} {gain(estimate)}; {left(estimate)}."


def found(estimate: Estimate) -> str:
    """The values, as the subject of the sentence."""
    parts = [text for family in BASE_FAMILIES for text in _by_leg(estimate, family)]
    others = [n for n in estimate.names if family_of(n).name not in BASE_FAMILIES]
    parts += [f"{parameter_words(n)} {_value(estimate, n)}" for n in others[:_MOST_NAMED]]
    if len(others) > _MOST_NAMED:
        parts.append(f"{len(others) - _MOST_NAMED} further parameters")
    text = listed(parts)
    return text[:1].upper() + text[1:]


def gain(estimate: Estimate) -> str:
    """What the fit does to the deviations."""
    before, after = estimate.nominal.deviation_rms * 1e3, estimate.scores.deviation_rms * 1e3
    verb = "hardly change" if after > _HARDLY * before else "reduce"
    places = decimals_for(after, 3)
    return f"{verb} the deviations from {before:.{places}f} to {after:.{places}f} mm"


def left(estimate: Estimate) -> str:
    """What remains, against the noise."""
    noise = estimate.problem.noise.typical * 1e3
    if estimate.scores.dof <= 0:
        return "no reading is left over to judge the fit by"
    if estimate.sigma_scale > 1:
        return (
            f"what is left is {estimate.sigma_scale:.2g} times the noise of a reading "
            f"({compact(noise, 2)} mm): the machine, or the measurement, has an error that "
            f"{explained_by(estimate)} cannot explain"
        )
    return (
        f"what is left is no more than the noise of a reading ({compact(noise, 2)} mm): these "
        f"readings show no further error"
    )


def explained_by(estimate: Estimate) -> str:
    """The families that were free, in the plural."""
    families = dict.fromkeys(family_of(name).name for name in estimate.names)
    return listed([f"{_TOLD.get(f, f.replace('_', ' '))}s" for f in families])


def _by_leg(estimate: Estimate, family: str) -> list[str]:
    """One phrase a family and campaign: ``joint offsets x -0.51, y +0.56 mm``."""
    groups: dict[str, list[str]] = {}
    for name in estimate.names:
        if family_of(name).name == family:
            groups.setdefault(name.partition("@")[2], []).append(name)
    phrases = []
    for campaign, names in groups.items():
        largest = max(abs(estimate.values[name]) for name in names)
        many = "s" if len(names) > 1 else ""
        where = f" ({campaign})" if campaign else ""
        if largest <= estimate.problem.noise.typical:
            within = compact(estimate.problem.noise.typical * 1e3, 1)
            phrases.append(f"{_TOLD[family]}{many} nominal to {within} mm{where}")
            continue
        values = ", ".join(f"{_member(name)} {_value(estimate, name, '')}" for name in names)
        unit = family_of(family).unit.name
        phrases.append(f"{_TOLD[family]}{many} {values} {unit}{where}")
    return phrases


def _value(estimate: Estimate, name: str, unit: str | None = None) -> str:
    of = family_of(name).unit
    # Along a weak direction sigmas are millimetres: what the readings do fix would be rounded off.
    places = 2 if of.name == "mm" else decimals_for(estimate.sigmas[name] / of.si, 9)
    text = signed(estimate.values[name] / of.si, places)
    return f"{text} {of.name}" if unit is None else text


def _member(name: str) -> str:
    return name.partition("@")[0].partition(".")[2]


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
