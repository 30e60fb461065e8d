"""What a drive does wrong: where its carriage stands along its own axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from orthoglide.effects.effect import Family, LegConditions, Motion, once
from orthoglide.units import MM, ONE, Unit


def _one(_: LegConditions) -> Any:
    return 1.0


def _lag(c: LegConditions) -> Any:
    return -c.approach / 2


def _phase(c: LegConditions) -> Any:
    # Without a pitch the error is no candidate; a basis of zero keeps the model the same shape.
    return 0.0 if c.pitch is None else 2 * np.pi * c.nominal_travel / c.pitch


def _sine(c: LegConditions) -> Any:
    import casadi  # here, as it is slow to load and files need no more than the names

    return 0.0 if c.pitch is None else casadi.sin(_phase(c))


def _cosine(c: LegConditions) -> Any:
    import casadi

    return 0.0 if c.pitch is None else casadi.cos(_phase(c))


JOINT_OFFSET = Family(
    "joint_offset",
    MM,
    2.0,
    because="zero marks are set by eye or by a switch, to a millimetre or two",
    sentence="the encoder's zero is not at mechanical zero",
    look_at="the reference switch and the zero mark of the drive",
    members=once(Motion("travel", _one)),
    group="drive",
)

ENCODER_SCALE = Family(
    "encoder_scale",
    ONE,
    1e-4,
    because="0.1 mm over a metre is a poor scale or a screw of class C7",
    sentence="the drive moves more or less than it is told, in proportion",
    look_at="the encoder's scale factor in the controller, the screw's lead, a warm screw",
    members=once(Motion("travel", lambda c: c.nominal_travel)),
    group="drive",
)

SCREW_ERROR = Family(
    "screw_error",
    MM,
    0.01,
    because="a rolled screw wobbles by about a hundredth within a turn",
    sentence="the drive runs ahead and behind once a turn of its screw",
    look_at="the screw's coupling and bearing, an encoder mounted off centre",
    members=lambda leg: {"sin": (Motion("travel", _sine),), "cos": (Motion("travel", _cosine),)},
    group="drive",
)

BACKLASH = Family(
    "backlash",
    MM,
    0.02,
    because="a preloaded nut keeps within two hundredths",
    sentence="the drive has lost motion: it stands differently when it comes from the other side",
    look_at="the preload of the nut, the coupling's clamp, the thrust bearing, the belt",
    members=once(Motion("travel", _lag)),
    group="drive",
)

DRIVE_COMPLIANCE = Family(
    "drive_compliance",
    Unit("mm/N", 1e-3),
    1e-4,
    because="a small ball screw drive gives a tenth of a micrometre a newton",
    sentence="the drive gives way under the load",
    look_at="the thrust bearing, the servo's stiffness, the carriage's clamp",
    members=once(Motion("travel", lambda c: c.force)),
    group="load",
)

FAMILIES = (JOINT_OFFSET, ENCODER_SCALE, SCREW_ERROR, BACKLASH, DRIVE_COMPLIANCE)
