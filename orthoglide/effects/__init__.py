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
from orthoglide.effects.words import Words
from orthoglide.parameters import Parameter

__all__ = [
    "CATALOGUE",
    "Catalogue",
    "DialReading",
    "Effect",
    "LegConditions",
    "Motion",
    "Parameter",
    "Words",
    "cos",
    "once",
    "relabelled",
    "sideways",
    "sin",
]
