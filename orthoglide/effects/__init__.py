"""The catalogue of effects: what real machines have and the nominal one lacks."""

from orthoglide.effects.catalogue import CATALOGUE, Catalogue, relabelled
from orthoglide.effects.effect import (
    DialReading,
    Effect,
    LegConditions,
    Motion,
    cos,
    once,
    sideways,
    sin,
)
from orthoglide.effects.names import (
    BASE_FAMILIES,
    DEFAULT_TOLERANCE,
    MACHINE_PARAMETERS,
    UNITS,
    elementary,
    expand,
    family_of,
    is_dial,
    structured,
    unit_of,
)
from orthoglide.effects.words import Words
from orthoglide.parameters import Parameter

__all__ = [
    "BASE_FAMILIES",
    "CATALOGUE",
    "DEFAULT_TOLERANCE",
    "MACHINE_PARAMETERS",
    "UNITS",
    "Catalogue",
    "DialReading",
    "Effect",
    "LegConditions",
    "Motion",
    "Parameter",
    "Words",
    "cos",
    "elementary",
    "expand",
    "family_of",
    "is_dial",
    "once",
    "relabelled",
    "sideways",
    "sin",
    "structured",
    "unit_of",
]
