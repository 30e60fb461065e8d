"""Measuring protocols: tables of readings to take, in their order.

All follow section 3 of the 2008 chapter: two dials at a time touch one leg while the nominal TCP
moves along that leg's axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.arguments import public
from orthoglide.errors import InputError, check_choice, check_type
from orthoglide.geometry import LEGS, Geometry
from orthoglide.instruments import Parallelism, Setup
from orthoglide.numerals import compact
from orthoglide.observations.approach import Moves, derive_approach, stroke_overshoot
from orthoglide.observations.readings import Readings
from orthoglide.text import MACHINE_OPTION

ProtocolName = Literal["standard", "sweep", "two-gauges", "parallelism"]

REPEATS = 3
"""Visits of every posture; the scatter of the repeats gives the noise."""

VISIT_SECONDS = 20.0
"""Time planned for a posture and its readings, seconds."""

MOUNTING_SECONDS = 600.0
"""Time planned from the last posture of a mounting to the first of the next, seconds."""


_GAUGES: dict[str, tuple[tuple[float, ...], ...]] = {
    "standard": ((0.5,),),
    "sweep": ((0.5,),),
    "two-gauges": ((0.35,), (0.65,)),
    "parallelism": ((0.35, 0.65),),
}
"""Places of the dials by mounting, as fractions of the leg."""

_SWEEP_UP = (0.33, 0.63, 1.0)
_SWEEP_DOWN = (0.27, 0.55, 0.84, 1.0)
"""Postures of a sweep, as fractions of the upper and of the lower half stroke. Uneven steps keep
short waves from looking like smooth curves: with these (16 to 30 mm on the default stroke) the
best parabola leaves at least 0.23 of a wave of period 6 to 60 mm; equal steps leave 0.02."""

_LABEL_DECIMALS = 9  # decimals of a metre

Posture = tuple[str, float]
"""A label and the travel from mechanical zero, metres."""


def require_dial_layout(geometry: Geometry) -> None:
    """Refuse a machine whose layout takes no dials on its legs.

    Raises:
        InputError: naming the readings that it takes instead.
    """
    check_type("the geometry", geometry, Geometry, "a Geometry, as machine.geometry is")
    if not geometry.dialled:
        raise InputError(
            f"dials are set against an Orthoglide's legs, and this machine's layout is "
            f"{geometry.layout.kind}: give readings of its tool (kind plate, distance, incline, "
            f"tcp or ballbar), for which orthoglide design --owns plate{MACHINE_OPTION} --out "
            f"SHEET.csv writes a sheet, and orthoglide.tool_sheets(machine, ['plate']) gives it in "
            f"Python"
        )


@public
def protocol(kind: ProtocolName, geometry: Geometry | None = None) -> Readings:
    """Return a campaign without readings, to be measured in its order.

    Args:
        kind: ``"standard"``: Zero, Max and Min of every axis with the dial at mid-leg, the
            chapter's own; ``"sweep"``: up and down the stroke in uneven steps, so that every
            posture is reached from both sides and short waves of a drive draw no smooth curve;
            ``"two-gauges"``: the sweep with the dials at 0.35 and then at 0.65 of the leg;
            ``"parallelism"``: the standard postures with two dials along each direction, at 0.35
            and at 0.65 of the leg, whose difference is read.
        geometry: whose stroke and length are used; the nominal one if None.

    Returns:
        The campaign, with readings nan and planned times, which are not written to files. Every
        mounting begins with a move, so that its first posture is reached from a known side.

    Raises:
        InputError: for an unknown kind, and a stroke over which a leg moves past a dial.
    """
    check_choice("protocol", kind, get_args(ProtocolName))
    geometry = geometry or Geometry()
    require_dial_layout(geometry)
    low, high = geometry.stroke
    extremes = [("zero", 0.0), ("max", high), ("min", low)]
    postures = extremes if kind in ("standard", "parallelism") else _sweep_postures(geometry)
    return leg_dial_campaign(geometry, kind, _GAUGES[kind], postures, REPEATS)


def leg_dial_campaign(
    geometry: Geometry,
    name: str,
    gauges: Sequence[tuple[float, ...]],
    postures: Sequence[Posture],
    repeats: int = 1,
    bar: int = 0,
) -> Readings:
    """Return a campaign without readings, of two dials at a time on each leg in turn, while the
    nominal TCP moves along that leg's axis. ``gauges``: places of the dials by mounting, as
    fractions of the leg: one, or two whose difference is read.

    Raises:
        InputError: where a leg moves past a dial.
    """
    _check_on_leg(geometry, gauges, [travel for _, travel in postures])
    visits = [
        (leg, repeat, posture)
        for leg in range(3)
        for _ in gauges
        for repeat in range(1, repeats + 1)
        for posture in postures
    ]
    setups = tuple(
        dial_setup(geometry, leg, axis, shares[0], bar, shares[1] if shares[1:] else None)
        for leg in range(3)
        for shares in gauges
        for axis in range(3)
        if axis != leg
    )
    visit = np.repeat(np.arange(len(visits)), 2)  # two dials read at each
    mounting = visit // (repeats * len(postures))
    command = np.array([geometry.command_on_axis(leg, travel) for leg, _, (_, travel) in visits])
    command = np.round(command, _LABEL_DECIMALS)[visit]  # what fits on a sheet
    sheet = Readings(
        name,
        setups,
        2 * mounting + np.arange(len(visit)) % 2,
        command,
        np.full(len(visit), np.nan),
        derive_approach(command, np.arange(len(visit))),
        time=visit * VISIT_SECONDS + mounting * (MOUNTING_SECONDS - VISIT_SECONDS),
        repeat=np.array([repeat for _, repeat, _ in visits])[visit],
        posture=tuple(visits[k][2][0] for k in visit),
        moves=Moves(overshoot=stroke_overshoot(geometry.stroke)),
    )
    return sheet.with_moves()


def dial_setup(
    geometry: Geometry, leg: int, axis: int, share: float, bar: int = 0, second: float | None = None
) -> Setup:
    """Return a mounting at a fraction of the leg, or of two dials at two fractions, named after
    them; ``bar`` as in `Setup`.
    """
    name = f"{LEGS[leg]}{LEGS[axis]}-{share:g}" + (f"-bar{bar}" if bar else "")
    gauge = round(share * geometry.L, 9)
    if second is None:
        return Setup(name, leg, axis, 1, gauge, bar)
    kind, second_gauge = Parallelism.kind, round(second * geometry.L, 9)
    return Setup(f"{name}-{second:g}", leg, axis, 1, gauge, bar, kind, second_gauge)


def _check_on_leg(
    geometry: Geometry, gauges: Sequence[tuple[float, ...]], travel: Sequence[float]
) -> None:
    """Refuse dials, at fractions of the leg, that it moves past within a travel, metres."""
    gauge = geometry.L * np.array([share for shares in gauges for share in shares])
    if gauge.min() <= max(travel) or gauge.max() >= geometry.L + min(travel):
        raise InputError(
            f"between travel {compact(min(travel) * 1e3, 6)} and {compact(max(travel) * 1e3, 6)} "
            f"mm a leg of {geometry.L * 1e3:g} mm moves past a dial set between "
            f"{gauge.min() * 1e3:.1f} and {gauge.max() * 1e3:.1f} mm along it: give "
            f"a shorter stroke in the machine file"
        )


def _sweep_postures(geometry: Geometry) -> list[Posture]:
    """Return postures from zero to the upper end, to the lower end, and back up to before zero."""
    low, high = geometry.stroke
    up, down = high * np.array([0.0, *_SWEEP_UP]), low * np.array(_SWEEP_DOWN)
    return labelled_postures(np.concatenate([up, up[-2::-1], down, down[-2::-1]]))


def labelled_postures(travel: ArrayLike) -> list[Posture]:
    """Return postures at travels from mechanical zero ``(n,)``, metres, each with its label."""
    return [
        (f"{s * 1e3:+.6g}", s)
        for s in np.round(np.asarray(travel, dtype=float), _LABEL_DECIMALS).tolist()
    ]
