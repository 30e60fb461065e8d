"""The catalogue of effects: what real machines have and the nominal one lacks."""

from orthoglide.effects.catalogue import (
    BASE_FAMILIES,
    CATALOGUE,
    MACHINE_PARAMETERS,
    expand,
    family_of,
    is_dial,
    structured,
)
from orthoglide.effects.effect import Family, LegConditions, Motion, relabelled

__all__ = [
    "BASE_FAMILIES",
    "CATALOGUE",
    "MACHINE_PARAMETERS",
    "Family",
    "LegConditions",
    "Motion",
    "expand",
    "family_of",
    "is_dial",
    "relabelled",
    "structured",
]
