"""The catalogue: every physical cause this package knows, and its parameters by name.

An effect is one entry of one of the files beside this one; see CONTRIBUTING.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from orthoglide.effects import bars, dials, drives, rails
from orthoglide.effects.effect import Family, Motion
from orthoglide.errors import InputError
from orthoglide.geometry import LEGS
from orthoglide.units import Unit, to_si

CATALOGUE: Mapping[str, Family] = MappingProxyType(
    {
        family.name: family
        for family in (
            *drives.FAMILIES,
            *rails.FAMILIES,
            *bars.FAMILIES,
            *dials.FAMILIES,
        )
    }
)
"""Families by name, in the order of tables."""

MOTIONS: Mapping[str, tuple[int, tuple[Motion, ...]]] = MappingProxyType(
    {name: moved for family in CATALOGUE.values() for name, moved in family.parameters().items()}
)
"""Every parameter of the machine itself: from name to leg (0, 1, 2) and motions."""

MACHINE_PARAMETERS: tuple[str, ...] = tuple(MOTIONS)
"""Names of all parameters of the machine itself (not of the dials), in catalogue order."""

BASE_FAMILIES: tuple[str, str] = ("joint_offset", "leg_length")
"""The parameters of the papers: what every identification starts with."""


def family_of(name: str) -> Family:
    """Family of a parameter, a structured member or a family itself.

    Raises:
        InputError: where the catalogue has no such family.
    """
    family = name.split("@")[0].partition(".")[0]
    if family not in CATALOGUE:
        known = ", ".join(CATALOGUE)
        raise InputError(f"there is no effect {family!r}: the catalogue has {known}")
    return CATALOGUE[family]


UNITS: Mapping[str, Unit] = MappingProxyType({n: f.unit for n, f in CATALOGUE.items()})
"""Unit of every family's parameters."""

DEFAULT_TOLERANCE: Mapping[str, float] = MappingProxyType(
    {name: to_si(family.tolerance, family.unit.si) for name, family in CATALOGUE.items()}
)
"""Default standard deviation to expect of every family, SI."""


def unit_of(name: str) -> Unit:
    """Unit of a parameter such as ``joint_offset.x``, or of a family.

    Raises:
        InputError: where the catalogue has no such family.
    """
    return family_of(name).unit


def is_dial(name: str) -> bool:
    """Whether a parameter belongs to a dial and not to the machine."""
    return family_of(name).group == "dial"


def check_parameter(name: str, setups: Iterable[str] = ()) -> None:
    """Refuse a name that is no parameter.

    Args:
        name: such as ``axis_tilt.y.z``, or ``gauge_scale.SETUP``.
        setups: names of the setups that dial parameters may carry; any where empty.

    Raises:
        InputError: saying which names there are.
    """
    family, setups = family_of(name), tuple(setups)
    if family.group == "dial":
        setup = name.partition(".")[2]
        if not setup or (setups and setup not in setups):
            raise InputError(f"{name}: {family.name} takes the name of a setup behind the dot")
    elif name not in MOTIONS:
        raise InputError(f"there is no parameter {name!r}: {family.name} has {_names(family)}")


def _names(family: Family) -> str:
    return ", ".join(family.parameters())


def expand(chosen: Iterable[str], setups: Iterable[str] = ()) -> tuple[str, ...]:
    """Parameter names for families or single parameters, in the order given, none twice.

    Raises:
        InputError: for what is neither.
    """
    setups, found = tuple(setups), {}
    for name in chosen:
        if name in CATALOGUE:
            family = CATALOGUE[name]
            many = (
                [f"{name}.{setup}" for setup in setups]
                if family.group == "dial"
                else list(family.parameters())
            )
        else:
            check_parameter(name, setups)
            many = [name]
        found.update(dict.fromkeys(many))
    return tuple(found)


def structured(name: str, setups: Iterable[str] = ()) -> dict[str, dict[str, float]]:
    """Structured members of a family: patterns of the machine's threefold symmetry.

    ``common`` gives every parameter the same value; where a family has a parameter for every leg
    and direction, ``cyclic`` is + for x.y, y.z, z.x and - for the others, and every pair of axes
    has a symmetric and an antisymmetric member.

    Args:
        name: of the family.
        setups: for the families of the dial.

    Returns:
        From the member's name to the weight of each parameter.
    """
    parameters = expand([name], setups)
    found: dict[str, dict[str, float]] = {}
    suffixes = {p.split(".", 2)[2] for p in parameters if p.count(".") == 2}
    if CATALOGUE[name].group != "dial" and suffixes == set(LEGS):
        found[f"{name}.common"] = dict.fromkeys(parameters, 1.0)
        found[f"{name}.cyclic"] = {p: _cyclic_sign(p) for p in parameters}
        for first, second in (("x", "y"), ("y", "z"), ("z", "x")):
            one, other = f"{name}.{first}.{second}", f"{name}.{second}.{first}"
            pair = f"{name}.{first}{second}"
            found[f"{pair}.symmetric"] = {one: 1.0, other: 1.0}
            found[f"{pair}.antisymmetric"] = {one: 1.0, other: -1.0}
    elif CATALOGUE[name].group != "dial" and suffixes:
        for suffix in sorted(suffixes):
            alike = [p for p in parameters if p.endswith(f".{suffix}")]
            found[f"{name}.{suffix}.common"] = dict.fromkeys(alike, 1.0)
    elif len(parameters) > 1:
        found[f"{name}.common"] = dict.fromkeys(parameters, 1.0)
    return found


def _cyclic_sign(parameter: str) -> float:
    _, leg, toward = parameter.split(".")
    return 1.0 if (LEGS.index(leg) + 1) % 3 == LEGS.index(toward) else -1.0
