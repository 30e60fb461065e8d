"""What a result means for a machine whose firmware computes the kinematics: numbers and limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.effects.effect import Shape
from orthoglide.fit import Estimate
from orthoglide.klipper import (
    AGAIN,
    ASSUMED,
    FIRST,
    RELATIVE,
    Corrections,
    disagreements,
    doubted_rods,
)
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.numerals import compact
from orthoglide.observations import ToolCampaign
from orthoglide.posterior import Cause, Explanation
from orthoglide.request import Request
from orthoglide.result.actions import confirm
from orthoglide.result.corrections import unseen_by_firmware

_SEEN, _HARDLY_SEEN, _NONE = 2.0, 0.5, 1e-3  # sigmas of a touch

UNSEEN = (
    "A mesh shows what the seven points of DELTA_CALIBRATE cannot see, or hardly; in brackets the "
    "most that each changes a height after their fit, in times the noise of a touch:"
)
"""Heading of what is briefly said to be unseen."""


@dataclass(frozen=True)
class Unseen:
    """A cause that the firmware's own seven points cannot see."""

    words: str  # of the cause
    shown: float  # the most that it changes a height after their fit, sigmas of a touch
    bends: bool  # whether their fit takes a plate's shape for the machine's

    @property
    def sentence(self) -> str:
        """All of it, without its full stop."""
        seen = "cannot see it" if self.shown < _HARDLY_SEEN else "hardly see it"
        bends = "; their fit bends the machine's numbers by it" if self.bends else ""
        size = f" by more than {compact(self.shown, 2)} times the noise of a touch"
        return (
            f"{self.words}: the seven points of DELTA_CALIBRATE {seen} (after their fit it changes "
            f"no height{size if self.shown > _NONE else ''}){bends}; a mesh can"
        )

    @property
    def brief(self) -> str:
        """What a heading leaves to say."""
        size = compact(self.shown, 2) if self.shown > _NONE else "0"
        return f"{self.words} ({size}{', and their fit bends the numbers' * self.bends})"


@dataclass(frozen=True)
class FirmwareAdvice:
    """Numbers to paste, and what they cannot hold."""

    first: str  # what must be known before anything else; empty where nothing must
    # old and new numbers; `None` where the plate, the firmware's z = 0, was not touched far out
    corrections: Corrections | None
    # causes that no number of the firmware holds, each with what to do about it
    beyond: tuple[str, ...]
    unseen: tuple[Unseen, ...]  # which of them its own seven points cannot see
    again: bool = False  # whether the firmware's own calibration comes first

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            **(self.corrections.as_dict() if self.corrections else {}),
            "first": self.first,
            "cannot_hold": list(self.beyond),
            "unseen_by_seven_points": [one.sentence for one in self.unseen],
        }


def apart(request: Request) -> Iterator[Note]:
    """Readings of an imported machine that are not of one plate and one set of its numbers."""
    if (old := request.machine.spec.printer) is not None:
        read = [c for c in request.points if isinstance(c, ToolCampaign)]
        relative = bool(request.machine.spec.provenance["klipper"].get(RELATIVE))
        yield from (one.note for one in disagreements(old, read, relative=relative))


def assumed(machine: Machine, causes: Sequence[Cause]) -> Iterator[Note]:
    """What was assumed of an imported machine and is so still, where causes depend on it."""
    kept = machine.spec.provenance.get("klipper")
    every = [one for cause in causes for one in cause.explanations]
    told = any(not one.catalogue.effect_of(one.name).of_dial for one in every)
    if not (told and isinstance(kept, Mapping) and isinstance(kept.get(ASSUMED), Mapping)):
        return
    geometry = machine.geometry
    below = float(geometry.legs[0].platform[2])
    now = {"r": geometry.r, "d": geometry.d, "tool_below": below}
    same = {n: v for n, v in kept[ASSUMED].items() if abs(now.get(n, np.inf) * 1e3 - v) < 1e-6}
    if same:
        words = {"r": "the platform's radius", "d": "the distance of an arm's two rods",
                 "tool_below": "how far the nozzle hangs below the joints"}  # fmt: skip
        sizes = ", ".join(f"{words[n]} ({v:g} mm)" for n, v in same.items())
        yield Note(
            f"assumed, as no firmware stores it: {sizes}; sizes of causes that turn the platform "
            f"go with that, and their uncertainty does not count it: measure it and correct it "
            f"in machine.toml",
            "assumed",
        )


def firmware_advice(
    found: Corrections | None, machine: Machine, fit: Estimate, causes: Sequence[Cause]
) -> FirmwareAdvice | None:
    """Advice for a machine that was imported, with new numbers where the plate was touched;
    ``None`` for others.
    """
    old = machine.spec.printer
    if old is None:
        return None
    every = [one for cause in causes for one in cause.explanations]
    again = bool(machine.spec.provenance["klipper"].get(AGAIN))
    return FirmwareAdvice(
        " ".join(text for text in (FIRST * again, doubted_rods(machine)) if text),
        found,
        tuple(f"{one.words}: {confirm(one) or f'look at {one.look_at}'}" for one in every),
        tuple(u for one in every if (u := _unseen(machine, fit, one)) is not None),
        again,
    )


def _unseen(machine: Machine, fit: Estimate, one: Explanation) -> Unseen | None:
    """A cause of the machine; ``None`` where the firmware's own points can see it."""
    catalogue, plate = machine.catalogue, dict[Shape, float]()
    for name, value in one.values.items():
        if (effect := catalogue.effect_of(name)).plate:
            plate[effect.shape(catalogue.parameter(name))] = value
    values = catalogue.moved_by(one.values)
    shown, bent = unseen_by_firmware(machine, fit, values, plate)
    if not (values or plate) or not shown < _SEEN:
        return None
    return Unseen(one.words, shown, bool(plate) and bent > _HARDLY_SEEN)
