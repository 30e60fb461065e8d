"""The catalogue of effects: what real machines have and the nominal one lacks."""

from orthoglide.effects.catalogue import (
    BASE_FAMILIES,
    CATALOGUE,
    DEFAULT_TOLERANCE,
    MACHINE_PARAMETERS,
    UNITS,
    expand,
    family_of,
    is_dial,
    structured,
    unit_of,
)
from orthoglide.effects.effect import Family, LegConditions, Motion, relabelled

__all__ = [
    "BASE_FAMILIES",
    "CATALOGUE",
    "DEFAULT_TOLERANCE",
    "MACHINE_PARAMETERS",
    "UNITS",
    "Family",
    "LegConditions",
    "Motion",
    "expand",
    "family_of",
    "is_dial",
    "relabelled",
    "structured",
    "unit_of",
]
