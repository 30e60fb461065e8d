"""The same machine with its legs renamed x -> y -> z -> x: parameters, readings."""

from dataclasses import replace

import numpy as np

from orthoglide.layout import LegNames, Orthoglide
from orthoglide.observations import Readings, Setup
from orthoglide.parameters import Parameter


def relabelled(name: Parameter, names: LegNames = Orthoglide.names) -> Parameter:
    """Return a parameter's name after the legs are renamed."""
    leg, direction = name.leg, name.direction
    if leg in names.legs:
        old = names.index(leg)
        new = (old + 1) % 3
        if direction in names.across[old]:
            direction = names.across[new][names.across[old].index(direction)]
        leg = names.legs[new]
    return Parameter(name.effect, leg, direction, name.setup, name.member, name.campaign)


def legs_renamed(readings: Readings) -> Readings:
    """Return the readings of the machine with its legs renamed; gravity and plates, which do not
    turn with the names, must not matter to them.
    """
    assert not readings.load.any()
    assert not readings.touching.any()

    def turned(s: Setup) -> Setup:
        leg, axis = ((k + 1) % 3 if k >= 0 else k for k in (s.leg, s.axis))
        x, y, z = s.beside
        return replace(s, leg=leg, axis=axis, beside=(z, x, y))

    directed = readings.which(lambda s: s.observation.axes)
    return replace(
        readings,
        setups=tuple(turned(s) for s in readings.setups),
        axis=np.where(directed, (readings.axis + 1) % 3, readings.axis),
        command=np.roll(readings.command, 1, axis=1),
        second=np.roll(readings.second, 1, axis=1),
        approach=np.roll(readings.approach, 1, axis=1),
        moves=replace(readings.moves, command=np.roll(readings.moves.command, 1, axis=1)),
    )
