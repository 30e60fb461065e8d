"""What drawings show of a machine: its dials, and what its parameters move."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from orthoglide.effects.wording import size_words
from orthoglide.effects.words import sign_word, toward
from orthoglide.geometry import Array
from orthoglide.instruments.leg_dial import BAR_WEIGHTS
from orthoglide.machine import Machine
from orthoglide.mechanism.tree import VIRTUAL_NAMES
from orthoglide.observations import Readings
from orthoglide.ordering import largest
from orthoglide.parameters import Parameter
from orthoglide.prediction import Conditions
from orthoglide.scene import Dial, Mark, Option, Posed
from orthoglide.scene.parts import Part

SHOWN_CONDITIONS: Mapping[str, float] = {
    "approach": 1.0,
    "time": 3600.0,
    "warming": 10.0,
    "load": 10.0,
}
"""Conditions at which what depends on them is shown: after a move outward, s, K, N."""

_PATH_POINTS = 33  # along the stroke
_MIN_END_SHARE = 0.3  # of the largest: what a path does at its outer end shows which way it goes
_PARTS: Mapping[str, tuple[Part, int]] = {
    "travel": ("drive", 0), "lateral_b": ("rail", 1), "lateral_c": ("rail", 2),
    "turn_a": ("carriage", 0), "turn_b": ("carriage", 1), "turn_c": ("carriage", 2),
    "stretch1": ("bar", 0), "stretch2": ("bar", 0), "width1": ("link", 2), "width2": ("link", 2),
}  # fmt: skip
"""Virtual joints as parts, each with the leg's axis a, b or c along or about which it moves."""


def dials(posture: Posed, campaigns: Iterable[Readings]) -> tuple[Dial, ...]:
    """Return the dials of campaigns on a machine, each name once."""
    found: dict[tuple[str, int], Dial] = {}
    for setup in (s for campaign in campaigns for s in campaign.setups):
        ends = np.einsum("b,bex->ex", np.array(BAR_WEIGHTS[setup.bar]), posture.lines[setup.leg])
        way = np.eye(3)[setup.axis] * setup.sign
        for k, gauge in enumerate(setup.gauges):
            place = gauge + posture.geometry.r
            share = (place - ends[0, setup.leg]) / (ends[1, setup.leg] - ends[0, setup.leg])
            at = ends[0] + share * (ends[1] - ends[0])
            found.setdefault((setup.name, k), Dial(setup.name, at, way))
    return tuple(found.values())


def option(machine: Machine, words: str, values: Mapping[str, float]) -> Option:
    """Return the marks of the parts that some parameters, SI, move.

    What hangs on approach, time, warmth or load is shown as it is after a move outward, an hour
    later, 10 K warmer, under 10 N.
    """
    groups: dict[tuple[str, ...], dict[Parameter, float]] = {}
    catalogue, marks = machine.catalogue, []
    for name, value in values.items():
        effect = catalogue.effect_of(name)
        if effect.of_dial:
            size, setup = size_words(effect, value), catalogue.parameter(name).setup
            part: Part = "plate" if effect.of_body else "dial"
            marks.append(Mark(part, -1, np.zeros(3), size, setup=setup))
    for p, value in catalogue.elementary_machine_values(values).items():
        direction = "" if catalogue.effect_of(p).paired else p.direction
        groups.setdefault((p.effect, p.leg, direction), {})[p] = value
    marks += [mark for group in groups.values() for mark in _marks(machine, group)]
    labels = {mark.label for mark in marks}
    if len(labels) == 1 < len(marks):  # said once for all
        first, *rest = marks
        marks = [replace(first, label=f"each {first.label}"), *(replace(m, label="") for m in rest)]
    return Option(words, tuple(marks))


def _marks(machine: Machine, values: dict[Parameter, float]) -> list[Mark]:
    """Return the marks of one leg; a part that several joints move is marked once."""
    first = next(iter(values))
    effect, (leg, _) = machine.catalogue.effect_of(first), machine.catalogue.motions[first]
    size = size_words(effect, math.hypot(*values.values())).partition(" (")[0]
    travel, moves = _displacements_along_stroke(
        machine, leg, {str(n): v for n, v in values.items()}
    )
    columns = moves[:, leg * len(VIRTUAL_NAMES) :]
    moving = {n: columns[:, k] for k, n in enumerate(VIRTUAL_NAMES) if columns[:, k].any()}
    stretched = [moving[n] for n in ("stretch1", "stretch2") if n in moving]
    alike = len(stretched) == 2 and np.allclose(stretched[0], stretched[1])
    found: dict[str, Mark] = {}
    for joint, curve in moving.items():
        part, _ = _PARTS[joint]
        which = joint if part == "bar" and not alike else part
        if which in found or (part == "carriage" and "rail" in found):
            continue
        text = "" if found else size
        both = "approach" in effect.needs
        found[which] = joint_mark(machine, leg, joint, travel, curve, text, both, alike)
    return list(found.values())


def _displacements_along_stroke(
    machine: Machine, leg: int, values: Mapping[str, float]
) -> tuple[Array, Array]:
    """Return travels and displacements of all virtual joints as one leg goes through its stroke.

    Where the platform hangs the others go with it, which could not follow one that goes alone.
    """
    geometry = machine.geometry
    travel = np.linspace(*geometry.stroke, _PATH_POINTS)
    command = np.repeat(geometry.zero[None], _PATH_POINTS, axis=0)
    command[:, slice(None) if geometry.layout.hanging else slice(leg, leg + 1)] += travel[:, None]
    # Only the load's force needs a posture that closes.
    where, place = machine.model.merged(
        Conditions.from_commands(command, **SHOWN_CONDITIONS), values
    )
    return travel, machine.model.displacements(values, where)[place]


def joint_mark(
    machine: Machine,
    leg: int,
    joint: str,
    travel: Array,
    curve: Array,
    size: str,
    both: bool = False,
    both_bars: bool = False,
) -> Mark:
    """Return the mark of one virtual joint.

    Args:
        machine: whose leg it is.
        leg: 0, 1 or 2.
        joint: its name within the leg.
        travel: from mechanical zero ``(k,)``, metres.
        curve: displacement there ``(k,)``, SI.
        size: in words; the direction is added.
        both: whether it moves either way.
        both_bars: whether both bars do the same.
    """
    part, axis = _PARTS[joint]
    k = largest(np.abs(curve))
    if abs(curve[-1]) > _MIN_END_SHARE * abs(curve[k]):
        k = len(curve) - 1
    size_there = float(np.abs(curve).max())
    sign = math.copysign(1.0, float(curve[k]))
    here = machine.geometry.legs[leg]
    way = sign * here.axes[:, axis]
    label, bar = size, 0
    if part == "bar":
        way = sign * (here.carriage - here.platform) / machine.geometry.L
        bar = 0 if both_bars else int(joint[-1])
        label = f"{size} {sign_word(sign, 'longer', 'shorter')}" if size else ""
    elif part == "rail" and size:
        direction = machine.catalogue.legs.across[leg][axis - 1]
        label = size if both else f"{size} toward {toward(direction, sign)}"
    elif part == "link" and size:
        label = f"{size} {sign_word(sign, 'wider', 'narrower')}"
    elif part == "drive" and size and not both:
        label = f"{size} {sign_word(sign, 'outward', 'inward')}"
    shape = np.stack([travel, curve * sign / size_there], axis=1)
    return Mark(part, leg, way, label, bar, float(travel[k]), shape, both)
