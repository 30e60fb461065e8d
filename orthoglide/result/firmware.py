"""What a result means for a machine whose firmware computes the kinematics: numbers and limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from orthoglide.fit import Estimate
from orthoglide.klipper import Corrections, corrections, firmware_of, rods_words, unseen_by_firmware
from orthoglide.machine import Machine
from orthoglide.posterior import Cause, Explanation
from orthoglide.result.actions import confirm

_SEEN = 2.0  # sigmas of a touch


@dataclass(frozen=True)
class FirmwareAdvice:
    """Numbers to paste, and what they cannot hold.

    Attributes:
        first: what must be known before anything else; empty where nothing must.
        corrections: old and new numbers.
        beyond: causes that no number of the firmware holds, each with what to do about it.
        unseen: which of them its own seven points cannot see, in sentences.
    """

    first: str
    corrections: Corrections
    beyond: tuple[str, ...]
    unseen: tuple[str, ...]

    @property
    def paste(self) -> str:
        """The new numbers as the file has them."""
        return "\n".join(self.corrections.new.lines())

    @property
    def undo(self) -> str:
        """The old ones, to undo it."""
        return "\n".join(self.corrections.old.lines())

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            **self.corrections.as_dict(),
            "first": self.first,
            "cannot_hold": list(self.beyond),
            "unseen_by_seven_points": list(self.unseen),
        }


def firmware_advice(
    imported: Machine, machine: Machine, fit: Estimate, causes: Sequence[Cause]
) -> FirmwareAdvice | None:
    """Advice for a machine that was imported; ``None`` for others.

    Args:
        imported: as its firmware stored it.
        machine: calibrated.
        fit: the last one.
        causes: that were added.
    """
    old = firmware_of(imported)
    found = None if old is None else corrections(old, machine, fit)
    if old is None or found is None:
        return None
    every = [one for cause in causes for one in cause.explanations]
    return FirmwareAdvice(
        rods_words(old),
        found,
        tuple(_beyond(one) for one in every),
        tuple(text for one in every if (text := _unseen(machine, fit, one))),
    )


def _beyond(one: Explanation) -> str:
    return f"{one.words}: {confirm(one) or f'look at {one.look_at}'}"


def _unseen(machine: Machine, fit: Estimate, one: Explanation) -> str:
    """A sentence where the firmware's own points cannot see a cause of the machine."""
    catalogue = machine.catalogue
    values: dict[str, float] = {}
    for name, value in one.values.items():
        if catalogue.effect_of(name).of_dial:
            return (
                f"{one.words}: seven points cannot see it, for it is no error of the machine, and "
                f"their fit bends the machine's numbers by it"
                if _is_plate(one)
                else ""
            )
        for part, weight in catalogue.elementary(name).items():
            values[part] = values.get(part, 0.0) + weight * value
    shown = unseen_by_firmware(machine, fit, list(values), values)
    if not shown < _SEEN:
        return ""
    return (
        f"{one.words}: the seven points of DELTA_CALIBRATE cannot see it (after their fit it "
        f"changes no height by more than {shown:.2g} times the noise of a touch); a mesh can"
    )


def _is_plate(one: Explanation) -> bool:
    return bool(one.catalogue.effect_of(one.name).plate)
