"""Clauses that describe a cause to a mechanic, from its name and its fitted values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from orthoglide.effects.catalogue import CATALOGUE, Catalogue
from orthoglide.effects.effect import Effect
from orthoglide.effects.words import Clause, across, filled, quantity, rotation_sense, toward
from orthoglide.layout import DIRECTIONS, LegNames, LinearDelta
from orthoglide.numerals import MINUS, compact
from orthoglide.parameters import Parameter, spaced, split_campaign

_DISPLAY_UNITS = {"mm": "mm", "rad": "mrad", "1": "%"}
_ABOUT = {"a": " about the legs' own axes", "b": " about their pivots"}


def cause_words(catalogue: Catalogue, name: str, values: Mapping[str, float]) -> str:
    """Return the clause that says what is wrong, with sign, size and unit.

    Args:
        catalogue: catalogue that contains the effect.
        name: name of the cause: a parameter, a structured member, an effect, or what paired
            parameters share (``screw_error.x``).
        values: identified values by parameter, SI.
    """
    effect, parameter = _resolve_name(catalogue, name)
    suffix = _campaign_suffix(parameter, name)
    parts = {n: v for n, v in values.items() if name in (n, catalogue.parameter(n).undirected)}
    if parameter is not None and parts:
        value, high_side = size_and_high_side(catalogue, parts)
        if parameter.member == "common" and effect.words.common is not None:
            text = _clause(effect, effect.words.common, parameter, value)
        elif parameter.member:
            pattern = effect.names.in_layout_words(_pattern(effect, parameter, value))
            text = f"{_clause_of_all(effect)}, {pattern}"
        else:
            text = value_words(effect, parameter, value, high_side)
        return text + suffix
    of_name = {n: v for n, v in values.items() if n.startswith(f"{name.split('@')[0]}.")}
    if not of_name:
        return _clause_of_all(effect) + suffix
    extremes = (f(of_name.values(), key=abs) for f in (min, max))
    smallest, largest = (_signed_size_or_amplitude(effect, value) for value in extremes)
    return f"{_clause_of_all(effect)}, from {smallest} to {largest}{suffix}"


def size_and_high_side(catalogue: Catalogue, values: Mapping[str, float]) -> tuple[float, float]:
    """Return the size of one parameter, or of a pair, SI, and the direction of a high side of a
    plate, degrees as of `Effect.high_side`, from identified values.
    """
    by_direction = {}
    for name, value in values.items():
        effect, parameter = _resolve_name(catalogue, name)
        by_direction[parameter.direction if parameter is not None else name] = value
    size = effect.amplitude(by_direction) if effect.paired else value
    return size, effect.high_side(by_direction)


def cause_short(catalogue: Catalogue, name: str) -> str:
    """Return the clause of a cause without its size."""
    effect, parameter = _resolve_name(catalogue, name)
    suffix = _campaign_suffix(parameter, name)
    if parameter is not None and not parameter.member:
        return _clause_without_size(effect, parameter) + suffix
    member = parameter.member if parameter is not None else ""
    return f"{_clause_of_all(effect)}{_short_pattern(effect, member)}{suffix}"


def value_words(
    effect: Effect, parameter: Parameter, value: float, high_side: float | None = None
) -> str:
    """Return the clause of one parameter with its value, SI, or of what those of a pair share with
    its amplitude; the high side of a plate, degrees, is by default that of the parameter alone.
    """
    if effect.words.one is not None:
        return _clause(effect, effect.words.one, parameter, value, high_side)
    size = _signed_size_or_amplitude(effect, value)
    return f"{_clause_without_size(effect, parameter)}, by {size}"


def confirm_words(
    effect: Effect, parameter: Parameter, value: float, high_side: float | None = None
) -> str:
    """Return a test on the machine that confirms a cause, with the reading to expect; arguments as
    of `value_words`.
    """
    if effect.words.confirm is not None:
        return _clause(effect, effect.words.confirm, parameter, value, high_side)
    size = _signed_size_or_amplitude(effect, value)
    return f"look at {effect.look_at}: expect {'an amplitude of ' * effect.paired}{size}"


def size_words(effect: Effect, value: float) -> str:
    """Return the absolute value of a size, SI, as text in the unit of the effect."""
    if (size := effect.words.size) is not None:
        return filled(size, Parameter(effect.name), value) if isinstance(size, str) else size(value)
    if effect.unit.name in _DISPLAY_UNITS:
        return quantity(value, _DISPLAY_UNITS[effect.unit.name])
    return f"{compact(abs(value) / effect.unit.si, 2)}{effect.unit.behind}"


def signed_size(effect: Effect, value: float) -> str:
    """Return a size, SI, as text with its sign."""
    return f"{'+' if value >= 0 else MINUS}{size_words(effect, value)}"


def _signed_size_or_amplitude(effect: Effect, value: float) -> str:
    """Return a size, SI, as text with its sign; paired parameters give an amplitude without one."""
    return size_words(effect, value) if effect.paired else signed_size(effect, value)


def difference_words(catalogue: Catalogue, name: str) -> str:
    """Return the noun phrase of a parameter, in front of its values or its difference."""
    parameter = catalogue.parameter(name)
    noun = catalogue.effect_of(parameter).words.noun
    return noun or parameter_words(parameter, catalogue.legs)


def parameter_words(parameter: Parameter, names: LegNames = CATALOGUE.legs) -> str:
    """Return the name of a parameter or structured member as words for tables, in those of a
    layout: ``axis tilt of leg y toward z`` for ``axis_tilt.y.z``.
    """
    return names.in_layout_words(_parameter_words(parameter, names.effect_words(parameter.effect)))


def _parameter_words(parameter: Parameter, words: str) -> str:
    suffix = f" ({parameter.campaign})" if parameter.campaign else ""
    if parameter.setup:
        shape = f", {parameter.direction}" if parameter.direction else ""
        return f"{words} of setup {parameter.setup}{shape}{suffix}"
    if parameter.member:
        return f"{words}, {parameter.member.replace('.', ' ')}{suffix}"
    if parameter.direction.isdigit():  # of a place's free function
        return f"curve {words}, number {parameter.direction}{suffix}"
    effect = CATALOGUE.by_name.get(parameter.effect)
    if _is_lateral(effect, parameter.direction):
        preposition = "toward" if effect is None else effect.points
        direction = toward(parameter.direction, 1.0)
        return f"{words} of leg {parameter.leg} {preposition} {direction}{suffix}"
    endings = {"sin": ", sine", "cos": ", cosine"}
    if parameter.effect in CATALOGUE.by_name:  # what an own effect does along b, it alone knows
        endings |= {"a": " about its axis", "b": " about its pivots"}
    ending = endings.get(parameter.direction, f" {parameter.direction}".rstrip())
    return f"{words} of leg {parameter.leg}{ending}{suffix}"


def grouped_by_effect(names: Iterable[str]) -> tuple[str, ...]:
    """Return parameters in short: an effect with several of them stands once, with their number."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name.partition(".")[0], []).append(name)
    return tuple(
        members[0] if len(members) == 1 else f"{spaced(effect)} ({len(members)} numbers)"
        for effect, members in groups.items()
    )


def _resolve_name(catalogue: Catalogue, name: str) -> tuple[Effect, Parameter | None]:
    """Return the effect of a name, and its parameter, its structured member or what the parameters
    of a pair share; ``None`` in place of these for a whole effect.
    """
    effect = catalogue.effect_of(name)
    plain, campaign = split_campaign(name)
    if plain == effect.name:
        return effect, None
    pairs = [Parameter(effect.name, leg) for leg in effect.names.legs] if effect.paired else []
    pairs += [Parameter(effect.name, member="common")] * effect.paired
    pair = next((p.at(campaign) for p in pairs if p == plain), None)
    parameter = pair or catalogue.parameter(name)
    if parameter.member and effect.of_body:  # one plate or part, in whatever setups it was read
        shape = parameter.member.rpartition(".")[0]
        parameter = Parameter(effect.name, direction=shape, campaign=parameter.campaign)
    return effect, parameter


def _campaign_suffix(parameter: Parameter | None, name: str) -> str:
    campaign = parameter.campaign if parameter is not None else name.partition("@")[2]
    return f" ({campaign})" if campaign else ""


def _clause(
    effect: Effect,
    clause: Clause,
    parameter: Parameter,
    value: float | None = None,
    high_side: float | None = None,
) -> str:
    """Return a clause of an effect for a parameter and its value; ``None`` without a size."""
    if isinstance(clause, str):
        size = "" if value is None else size_words(effect, value)
        if high_side is None:
            high_side = effect.high_side({parameter.direction: value or 0.0})
        text = filled(clause, parameter, value or 0.0, size, high_side)
    elif value is None:
        text = clause(parameter)
    else:
        text = clause(value) if parameter.member else clause(parameter, value)
    return text if effect.of_dial else effect.names.in_layout_words(text)


def _clause_without_size(effect: Effect, parameter: Parameter) -> str:
    if effect.words.short is not None:
        return _clause(effect, effect.words.short, parameter)
    place = f"in setup {parameter.setup}" if parameter.setup else f"on leg {parameter.leg}"
    lateral = _is_lateral(effect, parameter.direction)
    direction = f" toward {toward(parameter.direction, 1.0)}" if lateral else ""
    return f"{place} {effect.sentence}{direction}"


def _is_lateral(effect: Effect | None, direction: str) -> bool:
    """Return whether a direction lies across a leg; false for an axis of rotation."""
    return direction in DIRECTIONS or (direction in ("b", "c") and bool(effect and effect.sided))


def _clause_of_all(effect: Effect) -> str:
    place = "in all setups" if effect.of_dial else "on all legs"
    return effect.words.many or f"{place} {effect.sentence}"


def _short_pattern(effect: Effect, member: str) -> str:
    if member in ("", "size"):
        return ""
    if member.endswith("symmetric"):
        relation = "opposite ways" if member.endswith("antisymmetric") else "the same way"
        return f" ({member[0]} and {member[1]}, {relation})"
    if _is_lateral(effect, side := member.partition(".")[0]):
        return f", all alike in {across(side)}"
    about = _ABOUT.get(side, "") if "." in member else ""
    return ", in a threefold pattern" if member == "cyclic" else f", all by the same amount{about}"


def _pattern(effect: Effect, parameter: Parameter, value: float) -> str:
    size, member = size_words(effect, value), parameter.member
    if member == "cyclic":
        pairs = [
            f"{leg} toward {toward(b, value)} and {toward(c, -value)}"
            for leg, (b, c) in zip(effect.names.legs, effect.names.across, strict=True)
        ]
        return f"in a threefold pattern ({', '.join(pairs)}), by {size}"
    if member.endswith("symmetric"):
        first, second = member[0], member[1]
        way = toward(first, -value if member.endswith("antisymmetric") else value)
        return f"{first} toward {toward(second, value)} and {second} toward {way} by {size}"
    if _is_lateral(effect, side := member.partition(".")[0]):
        return f"all by {size} toward {toward(side, value)}"
    if "." in member and side in _ABOUT:
        sense = rotation_sense(side, value, effect.names == LinearDelta.names)
        return f"all by {size}{_ABOUT[side]}, {sense}"
    return f"all by {signed_size(effect, value)}"
