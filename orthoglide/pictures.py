"""Dials and marks of a machine's drawing, from its setups and its parameters."""

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
from orthoglide.scene.parts import Part, stroke_commands

SHOWN_CONDITIONS: Mapping[str, float] = {
    "approach": 1.0, "time": 3600.0, "warming": 10.0, "load": 10.0,
}  # fmt: skip
"""Conditions for which errors are drawn: after a move outward, s, K, N."""

_PATH_POINTS = 33  # along the stroke
_MIN_END_SHARE = 0.3  # displacement at the outer end over the largest from which its sign is shown
_PARTS: Mapping[str, tuple[Part, int]] = {
    "travel": ("drive", 0), "lateral_b": ("rail", 1), "lateral_c": ("rail", 2),
    "turn_a": ("carriage", 0), "turn_b": ("carriage", 1), "turn_c": ("carriage", 2),
    "stretch1": ("bar", 0), "stretch2": ("bar", 0), "width1": ("link", 2), "width2": ("link", 2),
}  # fmt: skip
"""Virtual joints as parts, each with the leg's axis a, b or c along or about which it moves."""

_WAYS: Mapping[str, tuple[str, str]] = {
    "bar": ("longer", "shorter"), "link": ("wider", "narrower"), "drive": ("outward", "inward"),
}  # fmt: skip
"""Words for a positive and for a negative displacement of a part."""


def dials(posture: Posed, campaigns: Iterable[Readings]) -> tuple[Dial, ...]:
    """Return the dials of campaigns on a machine, each name once."""
    by_name: dict[tuple[str, int], Dial] = {}
    for setup in (s for campaign in campaigns for s in campaign.setups):
        ends = np.einsum("b,bex->ex", np.array(BAR_WEIGHTS[setup.bar]), posture.lines[setup.leg])
        direction = np.eye(3)[setup.axis] * setup.sign
        for k, gauge in enumerate(setup.gauges):
            distance = gauge + posture.geometry.r
            share = (distance - ends[0, setup.leg]) / (ends[1, setup.leg] - ends[0, setup.leg])
            at = ends[0] + share * (ends[1] - ends[0])
            by_name.setdefault((setup.name, k), Dial(setup.name, at, direction))
    return tuple(by_name.values())


def option(machine: Machine, words: str, values: Mapping[str, float]) -> Option:
    """Return the marks of the parts that parameters with given values, SI, move.

    Errors that depend on approach, time, temperature or load are drawn for `SHOWN_CONDITIONS`.
    """
    groups: dict[tuple[str, ...], dict[Parameter, float]] = {}
    catalogue, marks = machine.catalogue, []
    of_setups: dict[Parameter, dict[str, float]] = {}
    for name, value in values.items():
        if (effect := catalogue.effect_of(name)).of_dial:
            parameter = catalogue.parameter(name)
            finding = parameter.undirected if effect.paired else parameter
            of_setups.setdefault(finding, {})[parameter.direction] = value
    for finding, sizes in of_setups.items():
        effect = catalogue.effect_of(finding)
        part: Part = "plate" if effect.of_body else "dial"
        size = size_words(effect, effect.amplitude(sizes))
        marks.append(Mark(part, -1, np.zeros(3), size, setup=finding.setup))
    for p, value in catalogue.elementary_machine_values(values).items():
        direction = "" if catalogue.effect_of(p).paired else p.direction
        groups.setdefault((p.effect, p.leg, direction), {})[p] = value
    marks += [mark for group in groups.values() for mark in _marks(machine, group)]
    labels = {mark.label for mark in marks}
    if len(labels) == 1 < len(marks):  # one label for all
        first, *rest = marks
        marks = [replace(first, label=f"each {first.label}"), *(replace(m, label="") for m in rest)]
    return Option(words, tuple(marks))


def _marks(machine: Machine, values: dict[Parameter, float]) -> list[Mark]:
    """Return the marks of one leg; a part that several joints move is marked once."""
    first = next(iter(values))
    effect, (leg, _) = machine.catalogue.effect_of(first), machine.catalogue.motions[first]
    amplitude = effect.amplitude({p.direction: value for p, value in values.items()})
    size = size_words(effect, amplitude).partition(" (")[0]
    travel, commands = stroke_commands(machine.geometry, leg, _PATH_POINTS)
    named = {str(n): v for n, v in values.items()}
    conditions = Conditions.from_commands(commands, **SHOWN_CONDITIONS)
    conditions, rows = conditions.merged(machine.model.needed_conditions(named))
    # Only the force of a load would need a closed posture.
    displacements = machine.model.displacements(named, conditions)[rows]
    columns = displacements[:, leg * len(VIRTUAL_NAMES) :]
    curves = {n: columns[:, k] for k, n in enumerate(VIRTUAL_NAMES) if columns[:, k].any()}
    stretched = [curves[n] for n in ("stretch1", "stretch2") if n in curves]
    both_bars = len(stretched) == 2 and np.allclose(stretched[0], stretched[1])
    marks: dict[str, Mark] = {}
    for joint, curve in curves.items():
        part, _ = _PARTS[joint]
        key = joint if part == "bar" and not both_bars else part
        if key in marks or (part == "carriage" and "rail" in marks):
            continue
        text = "" if marks else size
        both = "approach" in effect.needs
        marks[key] = joint_mark(machine, leg, joint, travel, curve, text, both, both_bars)
    return list(marks.values())


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
    """Return the mark of one virtual joint of a leg by its displacement, SI, at travels ``(k,)``
    from mechanical zero, metres.

    The direction is added to the size in words; ``both``: whether the joint moves both ways;
    ``both_bars``: whether both bars move equally.
    """
    part, axis = _PARTS[joint]
    k = largest(np.abs(curve))
    if abs(curve[-1]) > _MIN_END_SHARE * abs(curve[k]):
        k = len(curve) - 1
    amplitude = float(np.abs(curve).max())
    sign = math.copysign(1.0, float(curve[k]))
    leg_geometry = machine.geometry.legs[leg]
    vector = sign * leg_geometry.axes[:, axis]
    label, bar = size, 0
    if part == "bar":
        vector = sign * (leg_geometry.carriage - leg_geometry.platform) / machine.geometry.L
        bar = 0 if both_bars else int(joint[-1])
    if part == "rail" and size and not both:
        label = f"{size} toward {toward(machine.catalogue.legs.across[leg][axis - 1], sign)}"
    elif part in _WAYS and size and not both:
        label = f"{size} {sign_word(sign, *_WAYS[part])}"
    shape = np.stack([travel, curve * sign / amplitude], axis=1)
    return Mark(part, leg, vector, label, bar, float(travel[k]), shape, both)
