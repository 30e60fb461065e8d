"""What a result means for a machine whose firmware computes the kinematics: numbers and limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from orthoglide.effects.effect import Shape
from orthoglide.fit import Estimate
from orthoglide.klipper import Corrections, corrections, firmware_of, rods_words, unseen_by_firmware
from orthoglide.machine import Machine
from orthoglide.numerals import compact
from orthoglide.posterior import Cause, Explanation
from orthoglide.result.actions import confirm

_SEEN, _HARDLY_SEEN, _NONE = 2.0, 0.5, 1e-3  # sigmas of a touch


@dataclass(frozen=True)
class FirmwareAdvice:
    """Numbers to paste, and what they cannot hold.

    Attributes:
        first: what must be known before anything else; empty where nothing must.
        corrections: old and new numbers; ``None`` where the plate, which is the firmware's z = 0,
            was not touched.
        beyond: causes that no number of the firmware holds, each with what to do about it.
        unseen: which of them its own seven points cannot see, in sentences.
    """

    first: str
    corrections: Corrections | None
    beyond: tuple[str, ...]
    unseen: tuple[str, ...]

    @property
    def paste(self) -> str:
        """The new numbers as the file has them."""
        return "\n".join(self.corrections.new.lines()) if self.corrections else ""

    @property
    def undo(self) -> str:
        """The old ones, to undo it."""
        return "\n".join(self.corrections.old.lines()) if self.corrections else ""

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            **(self.corrections.as_dict() if self.corrections else {}),
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
    if old is None:
        return None
    every = [one for cause in causes for one in cause.explanations]
    return FirmwareAdvice(
        rods_words(old),
        corrections(old, machine, fit),
        tuple(_beyond(one) for one in every),
        tuple(text for one in every if (text := _unseen(machine, fit, one))),
    )


def _beyond(one: Explanation) -> str:
    return f"{one.words}: {confirm(one) or f'look at {one.look_at}'}"


def _unseen(machine: Machine, fit: Estimate, one: Explanation) -> str:
    """A sentence where the firmware's own points cannot see a cause of the machine."""
    catalogue = machine.catalogue
    values, plate = dict[str, float](), dict[Shape, float]()
    for name, value in one.values.items():
        if catalogue.effect_of(name).of_dial:
            shapes, parameter = dict(catalogue.effect_of(name).plate), catalogue.parameter(name)
            part = parameter.direction or parameter.member.rpartition(".")[0]
            plate |= {shapes[part]: value} if shapes else {}
            continue
        for part, weight in catalogue.elementary(name).items():
            values[part] = values.get(part, 0.0) + weight * value
    shown, bent = unseen_by_firmware(machine, fit, values, plate)
    if not (values or plate) or not shown < _SEEN:
        return ""
    bends = "; their fit bends the machine's numbers by it" if plate and bent > _HARDLY_SEEN else ""
    seen = "cannot see it" if shown < _HARDLY_SEEN else "hardly see it"
    size = f" by more than {compact(shown, 2)} times the noise of a touch" if shown > _NONE else ""
    return (
        f"{one.words}: the seven points of DELTA_CALIBRATE {seen} (after their fit it changes no "
        f"height{size}){bends}; a mesh can"
    )
