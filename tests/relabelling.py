"""The same machine with its legs renamed, x -> y -> z -> x on the Orthoglide: nothing may depend
on which leg is called what.
"""

from dataclasses import replace

import numpy as np

from orthoglide.effects import Parameter
from orthoglide.layout import LegNames, Orthoglide
from orthoglide.observations import Campaign


def relabelled(name: Parameter, names: LegNames = Orthoglide.names) -> Parameter:
    """A parameter's name after the legs are renamed."""
    leg, direction = next_leg(names, name.leg, name.direction)
    return Parameter(name.effect, leg, direction, name.setup, name.member, name.campaign)


def next_leg(names: LegNames, leg: str, direction: str) -> tuple[str, str]:
    """Names of a leg and a direction across it after the legs are renamed."""
    if leg not in names.legs:
        return leg, direction
    old, new = names.index(leg), (names.index(leg) + 1) % 3
    if direction in names.across[old]:
        direction = names.across[new][names.across[old].index(direction)]
    return names.legs[new], direction


def relabelled_campaign(campaign: Campaign) -> Campaign:
    """The campaign of the Orthoglide with its legs renamed."""
    assert not campaign.load.any(), "its weight acts along z, whatever the legs are called"
    turned = (replace(s, leg=(s.leg + 1) % 3, axis=(s.axis + 1) % 3) for s in campaign.setups)
    return replace(
        campaign,
        setups=tuple(turned),
        command=np.roll(campaign.command, 1, axis=1),
        approach=np.roll(campaign.approach, 1, axis=1),
        moves=replace(campaign.moves, command=np.roll(campaign.moves.command, 1, axis=1)),
    )
