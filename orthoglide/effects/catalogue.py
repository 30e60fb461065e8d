"""The catalogue: physical causes and their parameters by name. A machine has one; users extend it.

Its effects are defined in the other files of this folder, or by a user; see CONTRIBUTING.
"""

from __future__ import annotations

import copyreg
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property, partial
from typing import Any

from orthoglide.effects import bars, dials, drives, plates, rails
from orthoglide.effects.custom import check_bases
from orthoglide.effects.effect import Effect, Motion
from orthoglide.errors import InputError
from orthoglide.layout import Layout, LegNames, Orthoglide
from orthoglide.parameters import Parameter, effect_name, setup_parts, split_campaign
from orthoglide.units import to_si

CUSTOM_EFFECTS_HINT = (
    "your own come with --effects-file FILE.py, in Python with Machine.load(FILE, effects=[...]) "
    "or Machine.with_effects"
)
"""For errors: how an effect of a user's own becomes known."""

_BELT_TOLERANCES = {
    "joint_offset": 2.0, "leg_length": 0.05, "axis_offset": 1.0, "axis_tilt": 3e-3,
    "rail_tilt": 3e-3, "rail_bow": 0.1, "mount_tilt": 1e-2,
    "bar_mismatch": 0.05, "parallelogram_width": 0.3, "encoder_scale": 1e-2, "backlash": 0.05,
}  # fmt: skip
"""Standard deviations in the effects' own units; rods of one set are as even as anybody's. Belts
stretch, and a pulley's or a microstep's number is entered by hand: drives of three per cent too
much were reported."""


_COMMON_TOLERANCES = {"leg_length": 6.0}
"""Standard deviations, in the effects' own units, of the common error of parts of one set whose
size an owner enters: rods are even to a few hundredths, but their length is read off a rule or a
shop's page. Rods of 217 were entered as 234, 272 as 268, 288 as 270: of such errors of 4 to 18 mm
the largest is three standard deviations."""

_SHARED_TOLERANCES = {"axis_offset.radial.common": 1.35}
"""Standard deviations, in the effects' own units, of errors that legs share beside their own ones.
A firmware fits one radius of all towers, with drives and rods of the sizes entered: drives that
move 5 % more than told, which are the largest such errors, made it 2.7 mm too small, and these are
two standard deviations; rods 4 mm short made it 1.5 mm. With 2 mm a mesh of a real printer (V400)
was explained by rods, radius and drives 5 % smaller together, which a mesh hardly sees."""

MACHINE_CLASSES = ("laboratory", "belts")
"""Classes of machines: a carefully built one of ground steel, and belts on extrusions."""


@dataclass(frozen=True, repr=False)
class Catalogue(Mapping[str, Effect]):
    """Effects by name, in the order of tables. Immutable; equal where the effects are."""

    effects: tuple[Effect, ...]  # one entry a physical cause
    legs: LegNames = Orthoglide.names  # of the layout: names of legs and directions

    def __post_init__(self) -> None:
        for effect in self.effects:
            if effect.names != self.legs:
                raise InputError(f"{effect.name} belongs to another layout than its catalogue")
        names = [effect.name for effect in self.effects]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two effects are called {name!r}: rename one")

    def __repr__(self) -> str:
        return f"<Catalogue of {len(self)} effects: {', '.join(self)}>"

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

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return Catalogue, (self.effects, self.legs)

    def with_effects(self, more: Iterable[Effect]) -> Catalogue:
        """Return this catalogue with a user's effects appended, each once.

        Raises:
            InputError: where two effects share a name, or a basis does not work on symbols.
        """
        more = tuple(more) if isinstance(more, Iterable) else (more,)
        if not all(isinstance(e, Effect) for e in more):
            raise InputError(
                "effects are a list of your own, each an og.Effect: those of the catalogue are "
                "known without"
            )
        renamed = (e if e.names == self.legs else replace(e, names=self.legs) for e in more)
        added = [e for e in renamed if e not in self.effects]
        catalogue = Catalogue((*self.effects, *added), self.legs)
        for effect in added:
            check_bases(effect)
        return catalogue

    def for_layout(self, layout: Layout) -> Catalogue:
        """Return the catalogue of another layout, with the same user-defined effects."""
        if layout.names == self.legs:
            return self
        return catalogue_of(layout.names).with_effects(
            e for e in self.effects if CATALOGUE.by_name.get(e.name) is not e
        )

    @cached_property
    def base(self) -> tuple[str, ...]:
        """Effects with which every identification starts; in the papers, zeros and lengths."""
        return self.correctable_by(*self.legs.controller_entries)

    def correctable_by(self, *numbers: str) -> tuple[str, ...]:
        """Effects that numbers of a controller correct, such as its zeros: ``"zero"``."""
        return tuple(e.name for e in self.effects if e.controller in numbers)

    @cached_property
    def motions(self) -> Mapping[Parameter, tuple[int, tuple[Motion, ...]]]:
        """Every parameter of the machine itself: from name to leg (0, 1, 2) and motions."""
        return {name: moved for e in self.effects for name, moved in e.motions.items()}

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters of the machine itself (not of instruments), in catalogue order."""
        return tuple(self.motions)

    @cached_property
    def default_tolerance(self) -> Mapping[str, float]:
        """Default standard deviation to expect of every effect, SI."""
        return {e.name: e.tolerance_si for e in self.effects}

    @property
    def belt_tolerance(self) -> dict[str, float]:
        """Standard deviation to expect of every effect on a machine of belts, SI."""
        belts = {n: to_si(v, self[n].unit.si) for n, v in _BELT_TOLERANCES.items()}
        return {**self.default_tolerance, **belts}

    @property
    def common_tolerance(self) -> dict[str, float]:
        """Standard deviation to expect of the common part of an effect on all legs, SI."""
        return {n: to_si(v, self[n].unit.si) for n, v in _COMMON_TOLERANCES.items()}

    @property
    def shared_tolerance(self) -> dict[str, float]:
        """Standard deviation of the error that the parameters of a structured member share beside
        their own ones, by its name, SI.
        """
        return {
            n: to_si(v, self.effect_of(n).unit.si) for n, v in _SHARED_TOLERANCES.items()
            if n in self.structured_members(effect_name(n))
        }  # fmt: skip

    def effect_of(self, name: str) -> Effect:
        """Effect of a parameter, a structured member or an effect's own name.

        Raises:
            InputError: where the catalogue has no such effect.
        """
        effect = effect_name(name)
        if effect not in self.by_name:
            raise InputError(
                f"there is no effect {effect!r}: the catalogue has {', '.join(self)} "
                f"({CUSTOM_EFFECTS_HINT})"
            )
        return self.by_name[effect]

    def parameter(self, name: str, setups: Iterable[str] = ()) -> Parameter:
        """Return the `Parameter` of a name: an elementary parameter or a structured member.

        Args:
            name: such as ``axis_tilt.y.z``, ``axis_tilt.cyclic@april`` or ``gauge_scale.SETUP``.
            setups: names of the setups that dial parameters may carry; any where empty.

        Raises:
            InputError: for a name that is neither; the message lists the valid names.
        """
        if isinstance(name, Parameter):
            return name
        effect, setups = self.effect_of(name), tuple(setups)
        # Two setups have all members that dials share, whatever the setups are called.
        listed = setups or (("one", "other") if effect.of_dial else ())
        for names in (effect.parameters, partial(self.structured_members, effect.name)):
            for candidate in names(listed):
                if name == candidate or name.startswith(f"{candidate}@"):
                    return candidate.at(name[len(candidate) + 1 :])
        if not effect.of_dial:
            raise InputError(
                f"there is no parameter {name!r}: {effect.name} has {', '.join(effect.motions)}"
            )
        setup, shape, campaign = setup_parts(name[len(effect.name) + 1 :], effect.shapes)
        if setup and not setups:
            return Parameter(effect.name, setup=setup, direction=shape, campaign=campaign)
        choices = f", one of {', '.join(setups)}" if setups else ""
        raise InputError(f"{name}: {effect.name} takes the name of a setup behind the dot{choices}")

    def elementary_weights(self, name: str, setups: Iterable[str] = ()) -> dict[str, float]:
        """Weights of the parameters that a name stands for: itself, or a structured member's.

        Raises:
            InputError: for a name that is neither.
        """
        parameter = self.parameter(name, setups)
        if parameter.member:
            weights = self.structured_members(parameter.effect, setups)[parameter.plain]
            return {n.at(parameter.campaign): w for n, w in weights.items()}
        return {parameter: 1.0}

    def machine_values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters by name without those of instruments (dials, plates, parts)."""
        return {name: v for name, v in values.items() if not self.effect_of(name).of_dial}

    def elementary_machine_values(self, values: Mapping[str, float]) -> dict[Parameter, float]:
        """Return the elementary parameters of the machine, without those of instruments.

        Of parameters specific to campaigns the last one counts: the machine as it is now.
        """
        totals: dict[Parameter, float] = {}
        latest = {self.parameter(n).plain: v for n, v in self.machine_values(values).items()}
        for name, value in latest.items():
            for elementary, weight in self.elementary_weights(name).items():
                plain = self.parameter(elementary).plain
                totals[plain] = totals.get(plain, 0.0) + weight * value
        return totals

    def expand(self, chosen: Iterable[str], setups: Iterable[str] = ()) -> tuple[Parameter, ...]:
        """Parameters for effects, pairs or single names, in the order given, none twice.

        A pair, such as a sine and its cosine, has the name of its parameters without direction.

        Raises:
            InputError: for what is neither.
        """
        setups = tuple(setups)
        parameters: dict[Parameter, None] = {}
        for name in chosen:
            effect, (plain, campaign) = self.effect_of(name), split_campaign(name)
            members = effect.parameters(setups)
            if name != effect.name:
                pair = [p.at(campaign) for p in members if effect.paired and p.undirected == plain]
                members = tuple(pair) or (self.parameter(name, setups),)
            parameters.update(dict.fromkeys(members))
        return tuple(parameters)

    def with_shapes(self, values: Mapping[str, float]) -> Catalogue:
        """Return the catalogue with the shapes of free-form errors of a machine with these values,
        SI; each has its size as a structured member.
        """
        effects = list[Effect]()
        for effect in self.effects:
            if effect.size_of is not None:
                found = {n: values.get(n, 0.0) for n in effect.motions}
                size = effect.size_of({n.direction: v for n, v in found.items()})
                shape = tuple((n, v / size) for n, v in found.items()) if size else ()
                effect = replace(effect, shape=shape)
            effects.append(effect)
        return Catalogue(tuple(effects), self.legs)

    def structured_members(
        self, name: str, setups: Iterable[str] = ()
    ) -> dict[Parameter, dict[Parameter, float]]:
        """Structured members of an effect: patterns of the machine's threefold symmetry.

        ``common`` gives every parameter the same value; where an effect has a parameter for every
        leg and direction, ``cyclic`` is + for x.y, y.z, z.x and - for the others, and every pair of
        axes has a symmetric and an antisymmetric member.

        Returns:
            From the member's name to the weight of each parameter.
        """
        effect = self.by_name[name]
        parameters = effect.parameters(tuple(setups))
        directions = set() if effect.of_dial else {p.direction for p in parameters}
        members: dict[Parameter, dict[Parameter, float]] = {}

        def add(member: str, weights: dict[Parameter, float]) -> None:
            members[Parameter(name, member=member)] = weights

        if effect.size_of is not None:
            for leg in {p.leg for p, _ in effect.shape}:
                members[Parameter(name, leg, member="size")] = dict(effect.shape)
        elif directions == set(self.legs.legs):  # legs lie along each other's directions
            add("common", dict.fromkeys(parameters, 1.0))
            legs = self.legs.legs
            ahead = {leg: b for leg, (b, _) in zip(legs, self.legs.across, strict=True)}
            add("cyclic", {p: 1.0 if p.direction == ahead[p.leg] else -1.0 for p in parameters})
            for first, second in zip(legs, (*legs[1:], legs[0]), strict=True):
                one_way = Parameter(name, first, second)
                other_way = Parameter(name, second, first)
                add(f"{first}{second}.symmetric", {one_way: 1.0, other_way: 1.0})
                add(f"{first}{second}.antisymmetric", {one_way: 1.0, other_way: -1.0})
        elif directions - {""}:
            for direction in sorted(directions):
                add(f"{direction}.common", {p: 1.0 for p in parameters if p.direction == direction})
        elif effect.of_body:  # the same plate or part, however often it was measured
            for shape in effect.shapes or ("",):
                member = f"{shape}.common" if shape else "common"
                add(member, {p: 1.0 for p in parameters if p.direction == shape})
        elif len(parameters) > 1 and not effect.per_setup:
            add("common", dict.fromkeys(parameters, 1.0))
        return members


CATALOGUE = Catalogue(
    (*drives.EFFECTS, *rails.EFFECTS, *bars.EFFECTS, *dials.EFFECTS, *plates.EFFECTS)
)
"""The package's own effects on the Orthoglide."""


@cache
def catalogue_of(names: LegNames) -> Catalogue:
    """The package's own effects on a layout; one object for each."""
    if names == CATALOGUE.legs:
        return CATALOGUE
    effects = (*CATALOGUE.effects, *rails.DELTA_EFFECTS, *plates.DELTA_EFFECTS)
    return Catalogue(tuple(_in_layout_words(e, names) for e in effects), names)


def _in_layout_words(effect: Effect, names: LegNames) -> Effect:
    """An effect on a layout, in the words of that layout; names of setups stay as they are."""
    if effect.of_dial:
        return replace(effect, names=names)
    return replace(
        effect,
        names=names,
        sentence=names.in_layout_words(effect.sentence),
        look_at=names.in_layout_words(effect.look_at),
        words=replace(effect.words, many=names.in_layout_words(effect.words.many)),
    )


# An effect contains functions, which do not pickle: effects of the package are pickled by name.
def _effect_by_name(name: str, names: LegNames) -> Effect:
    return catalogue_of(names)[name]


def _reduce_effect(effect: Effect) -> tuple[Any, tuple[Any, ...]]:
    if catalogue_of(effect.names).by_name.get(effect.name) is effect:
        return _effect_by_name, (effect.name, effect.names)
    return Effect, tuple(getattr(effect, f.name) for f in fields(effect))


copyreg.pickle(Effect, _reduce_effect)
