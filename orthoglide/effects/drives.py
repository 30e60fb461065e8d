"""Errors of drives: displacements of the carriages along their own axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from orthoglide.effects.effect import Constant, Effect, LegConditions, Motion, cos, once, sin
from orthoglide.effects.words import Words
from orthoglide.units import MM, ONE, Unit


def _sine(c: LegConditions) -> Any:
    # Without a pitch the error is no candidate; a basis of zero keeps the model the same shape.
    return 0.0 if c.pitch is None else sin(2 * np.pi * c.nominal_travel / c.pitch)


def _cosine(c: LegConditions) -> Any:
    return 0.0 if c.pitch is None else cos(2 * np.pi * c.nominal_travel / c.pitch)


JOINT_OFFSET = Effect(
    "joint_offset",
    MM,
    2.0,
    because="zero marks are set by eye or by a switch, to a millimetre or two",
    sentence="the encoder's zero is not at mechanical zero",
    look_at="the reference switch and the zero mark of the drive",
    members=once(Motion("travel", Constant(1.0))),
    words=Words(
        "the zero of drive {leg} is {size} too far {out|in}",
        "the zero of drive {leg} is off",
        "the zeros of the drives are off",
        confirm="send drive {leg} to its zero and measure its carriage against the zero mark: "
        "expect it {size} too far {out|in}",
        common="the zeros of all drives are {size} too far {out|in}",
    ),
    group="drive",
    controller="zero",
    urdf=True,
)

ENCODER_SCALE = Effect(
    "encoder_scale",
    ONE,
    1e-4,
    because="0.1 mm over a metre is a poor scale or a screw of class C7",
    sentence="the drive moves more or less than commanded, in proportion",
    look_at="the drive's scale in the controller, the screw's lead or a belt's pulley: measure "
    "100 mm of the carriage's travel, or all of a shorter stroke",
    members=once(Motion("travel", lambda c: c.nominal_travel)),
    words=Words(
        "drive {leg} moves {size} {more|less} than commanded",
        "drive {leg} moves more or less than commanded",
        "the drives move more or less than commanded",
        confirm="set a dial or a scale on carriage {leg} and command a long move: expect "
        "{mm:50e-3} {more|less} than commanded for 50 mm of it",
        common="all drives move {size} {more|less} than commanded",
    ),
    group="drive",
    controller="scale",
)

SCREW_ERROR = Effect(
    "screw_error",
    MM,
    0.01,
    because="a rolled screw wobbles by about a hundredth within a turn",
    sentence="the drive runs ahead and behind once a turn of its screw",
    look_at="the screw's coupling and bearing, an encoder mounted off centre",
    members=lambda leg: {"sin": (Motion("travel", _sine),), "cos": (Motion("travel", _cosine),)},
    words=Words(
        "drive {leg} runs {size} ahead and behind once a turn of its screw",
        "drive {leg} runs ahead and behind once a turn of its screw",
        "the drives run ahead and behind once a turn of their screws",
        confirm="set a dial on carriage {leg} and move one turn of the screw in eight steps: "
        "expect the errors of the steps to span {mm:2}",
    ),
    group="drive",
    paired=True,
)

BACKLASH = Effect(
    "backlash",
    MM,
    0.02,
    because="a preloaded nut keeps within two hundredths",
    sentence="the drive has lost motion: it stands differently when it comes from the other side",
    look_at="the preload of the nut, the coupling's clamp, the thrust bearing, the belt",
    members=once(Motion("travel", lambda c: -c.approach / 2)),
    words=Words(
        "drive {leg} has {size} of lost motion"
        "{| with the wrong sign, as where a controller makes up for too much}",
        "drive {leg} has lost motion",
        "the drives have lost motion",
        confirm="set a dial on carriage {leg} and come to one place from smaller and from larger "
        "travel: expect it {size} {farther out|farther in} when it comes from larger travel",
        common="all drives have {size} of lost motion"
        "{| with the wrong sign, as where a controller makes up for too much}",
    ),
    group="drive",
    controller="backlash",
)

DRIVE_COMPLIANCE = Effect(
    "drive_compliance",
    Unit("mm/N", 1e-3),
    1e-4,
    because="a small ball screw drive gives a tenth of a micrometre a newton",
    sentence="the drive gives way under the load",
    look_at="the thrust bearing, the servo's stiffness, the carriage's clamp",
    members=once(Motion("travel", lambda c: c.force)),
    words=Words(
        "drive {leg} {gives way|moves against the load} by {size}",
        "drive {leg} gives way under the load",
        "the drives give way under the load",
        "{µm} a newton",
        "set a dial on carriage {leg} and push with 10 N along its rail: expect {µm:10} "
        "{with|against} the push",
        common="all drives {give way|move against the load} by {size}",
    ),
    group="load",
)

EFFECTS = (JOINT_OFFSET, ENCODER_SCALE, SCREW_ERROR, BACKLASH, DRIVE_COMPLIANCE)
