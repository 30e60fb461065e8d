"""The catalogue of effects: physical errors of real machines."""

from orthoglide.effects.catalogue import (
    CATALOGUE as CATALOGUE,
    Catalogue as Catalogue,
    catalogue_of as catalogue_of,
)
from orthoglide.effects.effect import (
    DRIVE_ENTRIES as DRIVE_ENTRIES,
    DialReading as DialReading,
    Effect as Effect,
    LegConditions as LegConditions,
    Motion as Motion,
    cos as cos,
    once as once,
    sideways as sideways,
    sin as sin,
)
from orthoglide.effects.words import Words as Words
from orthoglide.parameters import Parameter as Parameter
