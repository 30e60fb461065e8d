"""The catalogue: physical causes and their parameters by name. A machine has one; users extend it.

An effect is one entry of one of the files beside this one, or a user's own; see CONTRIBUTING.
"""

from __future__ import annotations

import copyreg
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from orthoglide.effects import bars, dials, drives, rails
from orthoglide.effects.effect import Effect, Motion
from orthoglide.errors import InputError
from orthoglide.geometry import LEGS
from orthoglide.parameters import Parameter, setup_and_campaign

_PAIRS = (("x", "y"), ("y", "z"), ("z", "x"))


@dataclass(frozen=True)
class Catalogue(Mapping[str, Effect]):
    """Effects by name, in the order of tables. Immutable; equal where the effects are.

    Attributes:
        effects: one entry a physical cause.
    """

    effects: tuple[Effect, ...]

    def __post_init__(self) -> None:
        names = [effect.name for effect in self.effects]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two effects are called {name!r}: rename one")

    @cached_property
    def by_name(self) -> Mapping[str, Effect]:
        """Effects by name."""
        return {effect.name: effect for effect in self.effects}

    def __getitem__(self, name: str) -> Effect:
        return self.by_name[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.by_name)

    def __len__(self) -> int:
        return len(self.effects)

    def with_effects(self, more: Iterable[Effect]) -> Catalogue:
        """The same with a user's own effects behind; those that are in already are not repeated.

        Raises:
            InputError: where two effects share a name.
        """
        return Catalogue((*self.effects, *(e for e in more if e not in self.effects)))

    @cached_property
    def base(self) -> tuple[str, ...]:
        """The effects of the papers, with which every identification starts: zeros and lengths."""
        return tuple(e.name for e in self.effects if e.controller in ("zero", "bar_length"))

    @cached_property
    def zeros(self) -> tuple[str, ...]:
        """The effects that a controller's zeros hold."""
        return tuple(e.name for e in self.effects if e.controller == "zero")

    @cached_property
    def motions(self) -> Mapping[Parameter, tuple[int, tuple[Motion, ...]]]:
        """Every parameter of the machine itself: from name to leg (0, 1, 2) and motions."""
        return {name: moved for e in self.effects for name, moved in e.motions.items()}

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters of the machine itself (not of the dials), in catalogue order."""
        return tuple(self.motions)

    @cached_property
    def of_dials(self) -> tuple[Effect, ...]:
        """Effects of the dials, in the order in which they change a reading."""
        return tuple(e for e in self.effects if e.of_dial)

    @cached_property
    def default_tolerance(self) -> Mapping[str, float]:
        """Default standard deviation to expect of every effect, SI."""
        return {e.name: e.tolerance_si for e in self.effects}

    def effect_of(self, name: str) -> Effect:
        """Effect of a parameter, a structured member or an effect's own name.

        Raises:
            InputError: where the catalogue has no such effect.
        """
        effect = name.effect if isinstance(name, Parameter) else name.split("@")[0].split(".")[0]
        if effect not in self.by_name:
            known = ", ".join(self)
            raise InputError(f"there is no effect {effect!r}: the catalogue has {known}")
        return self.by_name[effect]

    def parameter(self, name: str, setups: Iterable[str] = ()) -> Parameter:
        """A name as a `Parameter`: of a parameter, or of a structured member.

        Args:
            name: such as ``axis_tilt.y.z``, ``axis_tilt.cyclic@april`` or ``gauge_scale.SETUP``.
            setups: names of the setups that dial parameters may carry; any where empty.

        Raises:
            InputError: for a name that is neither, saying which there are.
        """
        if isinstance(name, Parameter):
            return name
        effect, setups = self.effect_of(name), tuple(setups)
        plain, _, campaign = name.partition("@")
        if effect.of_dial:
            setup, own = setup_and_campaign(name[len(effect.name) + 1 :])
            for known in effect.parameters(setups):
                if name == known or name.startswith(f"{known}@"):
                    return known.at(name[len(known) + 1 :])
            if setup and plain != f"{effect.name}.common" and not setups:
                return Parameter(effect.name, setup=setup, campaign=own)
        else:
            for known in effect.motions:
                if plain == known:
                    return known.at(campaign)
        for member in self.structured(effect.name, setups):
            if plain == member:
                return member.at(campaign)
        if effect.of_dial:
            raise InputError(f"{name}: {effect.name} takes the name of a setup behind the dot")
        raise InputError(
            f"there is no parameter {name!r}: {effect.name} has {', '.join(effect.motions)}"
        )

    def elementary(self, name: str, setups: Iterable[str] = ()) -> dict[str, float]:
        """Weights of the parameters that a name stands for: itself, or a structured member's.

        Raises:
            InputError: for a name that is neither.
        """
        parameter = self.parameter(name, setups)
        if parameter.member:
            weights = self.structured(parameter.effect, setups)[parameter.plain]
            return {n.at(parameter.campaign): w for n, w in weights.items()}
        return {parameter: 1.0}

    def expand(self, chosen: Iterable[str], setups: Iterable[str] = ()) -> tuple[Parameter, ...]:
        """Parameters for effects or single names, in the order given, none twice.

        Raises:
            InputError: for what is neither.
        """
        setups = tuple(setups)
        found: dict[Parameter, None] = {}
        for name in chosen:
            if name in self.by_name:
                found.update(dict.fromkeys(self.by_name[name].parameters(setups)))
            else:
                found[self.parameter(name, setups)] = None
        return tuple(found)

    def structured(
        self, name: str, setups: Iterable[str] = ()
    ) -> dict[Parameter, dict[Parameter, float]]:
        """Structured members of an effect: patterns of the machine's threefold symmetry.

        ``common`` gives every parameter the same value; where an effect has a parameter for every
        leg and direction, ``cyclic`` is + for x.y, y.z, z.x and - for the others, and every pair of
        axes has a symmetric and an antisymmetric member.

        Args:
            name: of the effect.
            setups: for effects of the dial.

        Returns:
            From the member's name to the weight of each parameter.
        """
        effect = self.by_name[name]
        every = effect.parameters(tuple(setups))
        directions = {p.direction for p in every}
        found: dict[Parameter, dict[Parameter, float]] = {}

        def add(member: str, weights: dict[Parameter, float]) -> None:
            found[Parameter(name, member=member)] = weights

        if directions == set(LEGS):
            add("common", dict.fromkeys(every, 1.0))
            add("cyclic", {p: _cyclic_sign(p) for p in every})
            for first, second in _PAIRS:
                one = Parameter(name, first, second)
                other = Parameter(name, second, first)
                add(f"{first}{second}.symmetric", {one: 1.0, other: 1.0})
                add(f"{first}{second}.antisymmetric", {one: 1.0, other: -1.0})
        elif directions - {""}:
            for direction in sorted(directions):
                add(f"{direction}.common", {p: 1.0 for p in every if p.direction == direction})
        elif len(every) > 1:
            add("common", dict.fromkeys(every, 1.0))
        return found


def _cyclic_sign(parameter: Parameter) -> float:
    return 1.0 if (LEGS.index(parameter.leg) + 1) % 3 == LEGS.index(parameter.direction) else -1.0


CATALOGUE = Catalogue((*drives.EFFECTS, *rails.EFFECTS, *bars.EFFECTS, *dials.EFFECTS))
"""The package's own effects."""


def relabelled(name: Parameter) -> Parameter:
    """The parameter's name after the axes are relabelled x -> y -> z -> x."""
    turned = [LEGS[(LEGS.index(k) + 1) % 3] if k in LEGS else k for k in (name.leg, name.direction)]
    return Parameter(name.effect, turned[0], turned[1], name.setup, name.member, name.campaign)


# An effect holds functions, which do not travel between processes: those of the package go by name.
def _effect_by_name(name: str) -> Effect:
    return CATALOGUE[name]


def _reduce_effect(effect: Effect) -> tuple[Any, tuple[Any, ...]]:
    if CATALOGUE.by_name.get(effect.name) is effect:
        return _effect_by_name, (effect.name,)
    return Effect, tuple(getattr(effect, f.name) for f in fields(effect))


def _reduce_catalogue(catalogue: Catalogue) -> tuple[Any, tuple[Any, ...]]:
    return Catalogue, (catalogue.effects,)


copyreg.pickle(Effect, _reduce_effect)
copyreg.pickle(Catalogue, _reduce_catalogue)
