"""The catalogue of effects: what real machines have and the nominal one lacks."""

from orthoglide.effects.catalogue import CATALOGUE, Catalogue, catalogue_of, relabelled
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
