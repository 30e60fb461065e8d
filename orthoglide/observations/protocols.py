"""Measuring protocols: which readings to take, in which order, before any is taken.

All follow section 3 of the 2008 chapter: two dials at a time touch one leg while the nominal TCP
moves along that leg's axis.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from orthoglide.errors import InputError
from orthoglide.geometry import LEGS, Geometry
from orthoglide.observations.approach import derive_approach
from orthoglide.observations.campaign import Campaign, Setup

Kind = Literal["standard", "sweep", "two-gauges"]

REPEATS = 3
"""How often every posture is visited; the scatter of the repeats is the noise."""

VISIT = 20.0
"""Time planned for a posture and its readings, seconds."""

MOUNTING = 600.0
"""Time planned from the last posture of a mounting to the first of the next, seconds."""


_GAUGES: dict[str, tuple[float, ...]] = {
    "standard": (0.5,),
    "sweep": (0.5,),
    "two-gauges": (0.35, 0.65),
}
"""Where the dials stand, as fractions of the leg."""

_PARTS = (3, 4)  # of the upper and the lower half stroke: about equal steps on the default one

Posture = tuple[str, float]
"""A label and the travel from mechanical zero, metres."""


def protocol(kind: Kind, geometry: Geometry | None = None) -> Campaign:
    """A campaign without readings, to be measured in its order.

    Args:
        kind: ``"standard"``: Zero, Max and Min of every axis with the dial at mid-leg, the
            chapter's own; ``"sweep"``: up and down the stroke in steps, so that every posture is
            reached from both sides; ``"two-gauges"``: the sweep with the dials at 0.35 and then
            at 0.65 of the leg.
        geometry: whose stroke and length count; the nominal one if None.

    Returns:
        The campaign, readings nan; times are those planned. Every mounting begins with a move, so
        that its first posture is reached from a known side.

    Raises:
        InputError: for an unknown kind.
    """
    if kind not in get_args(Kind):
        raise InputError(f"there is no protocol {kind!r}: it is one of {', '.join(get_args(Kind))}")
    geometry = geometry or Geometry()
    postures = _named(geometry) if kind == "standard" else _swept(geometry)
    visits = [
        (leg, gauge, repeat, posture)
        for leg in range(3)
        for gauge in _GAUGES[kind]
        for repeat in range(1, REPEATS + 1)
        for posture in postures
    ]
    setups = tuple(
        Setup(f"{LEGS[leg]}{LEGS[axis]}-{gauge:g}", leg, axis, 1, round(gauge * geometry.L, 9))
        for leg in range(3)
        for gauge in _GAUGES[kind]
        for axis in range(3)
        if axis != leg
    )
    visit = np.repeat(np.arange(len(visits)), 2)  # two dials read at each
    mounting = visit // (REPEATS * len(postures))
    command = [geometry.command_on_axis(leg, travel) for leg, _, _, (_, travel) in visits]
    n = len(visit)
    order = np.arange(n)
    rho = np.round(command, 9)[visit]  # what fits on a sheet
    sheet = Campaign(
        name=kind,
        setups=setups,
        setup=2 * mounting + order % 2,
        command=rho,
        approach=derive_approach(rho, order),
        time=visit * VISIT + mounting * (MOUNTING - VISIT),
        temperature=np.full(n, np.nan),
        load=np.zeros(n),
        repeat=np.array([repeat for _, _, repeat, _ in visits])[visit],
        order=order,
        posture=tuple(visits[k][3][0] for k in visit),
        reading=np.full(n, np.nan),
        sigma=np.full(n, np.nan),
        line=order + 2,
    )
    return sheet.with_moves()


def _named(geometry: Geometry) -> list[Posture]:
    low, high = geometry.stroke
    return [("zero", 0.0), ("max", high), ("min", low)]


def _swept(geometry: Geometry) -> list[Posture]:
    """From zero to one end and back, then to the other; the next round begins back at zero."""
    low, high = geometry.stroke
    up, down = np.arange(_PARTS[0] + 1) / _PARTS[0], np.arange(_PARTS[1] + 1) / _PARTS[1]
    travel = np.concatenate([high * up, high * up[-2::-1], low * down[1:], low * down[-2:0:-1]])
    return [(f"{s * 1e3:+.6g}", float(s)) for s in travel]
