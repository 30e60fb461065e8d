"""Names of the package's own catalogue, for code that has no machine at hand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from orthoglide.effects.catalogue import CATALOGUE
from orthoglide.effects.effect import Effect
from orthoglide.parameters import Parameter
from orthoglide.units import Unit

BASE_FAMILIES: tuple[str, ...] = CATALOGUE.base
MACHINE_PARAMETERS: tuple[str, ...] = CATALOGUE.parameters
UNITS: Mapping[str, Unit] = {n: e.unit for n, e in CATALOGUE.items()}
DEFAULT_TOLERANCE = CATALOGUE.default_tolerance


def family_of(name: str) -> Effect:
    """Effect of a name."""
    return CATALOGUE.effect_of(name)


def unit_of(name: str) -> Unit:
    """Unit of a name."""
    return CATALOGUE.effect_of(name).unit


def is_dial(name: str) -> bool:
    """Whether a parameter belongs to a dial and not to the machine."""
    return CATALOGUE.effect_of(name).of_dial


def structured(name: str, setups: Iterable[str] = ()) -> dict[Parameter, dict[Parameter, float]]:
    """Structured members of an effect."""
    return CATALOGUE.structured(name, setups)


def expand(chosen: Iterable[str], setups: Iterable[str] = ()) -> tuple[Parameter, ...]:
    """Parameters for effects or single names."""
    return CATALOGUE.expand(chosen, setups)


def check_parameter(name: str, setups: Iterable[str] = ()) -> None:
    """Refuse a name that is no parameter."""
    if CATALOGUE.parameter(name, setups).member:
        raise_for(name)


def raise_for(name: str) -> None:
    """Say which parameters there are."""
    from orthoglide.errors import InputError

    effect = CATALOGUE.effect_of(name)
    raise InputError(
        f"there is no parameter {name!r}: {effect.name} has {', '.join(effect.motions)}"
    )


def elementary(name: str, setups: Iterable[str] = ()) -> dict[str, float]:
    """Weights of the parameters that a name stands for."""
    return CATALOGUE.elementary(name, setups)
