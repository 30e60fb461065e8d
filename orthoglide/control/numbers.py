"""The numbers a controller takes of a calibrated machine, with the sign rules written out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from orthoglide.geometry import LEGS
from orthoglide.machine import Machine

_LEFT_OVER = frozenset({"joint_offset", "encoder_scale", "backlash", "leg_length"})


@dataclass(frozen=True)
class DriveNumbers:
    """What one drive's controller takes, in its own counting.

    The carriage stands at ``s = (1 + scale) c + offset`` from mechanical zero where the controller
    commands ``c = sign (shown - zero)``; with lost motion B, ``B/2`` behind the last move.

    Attributes:
        leg: ``"x"``, ``"y"`` or ``"z"``.
        sign: +1 where the controller counts away from the origin, else -1.
        zero: what it showed at mechanical zero as the machine file says, metres.
        offset: joint offset, metres.
        scale: relative scale error.
        backlash: lost motion, metres.
        bar_length: mean length of the leg's bars, metres.
    """

    leg: str
    sign: int
    zero: float
    offset: float
    scale: float
    backlash: float
    bar_length: float

    @property
    def new_zero(self) -> float:
        """What the controller is to show at mechanical zero, metres, its scale put right."""
        return self.zero - self.sign * self.offset

    @property
    def correction(self) -> float:
        """What to add to every command of the nominal machine, in the controller's counting."""
        return self.new_zero - self.zero

    @property
    def scale_factor(self) -> float:
        """By what to multiply commanded distances (or the counts per millimetre)."""
        return 1 / (1 + self.scale)

    @property
    def one_sided_zero(self) -> float:
        """``new_zero`` where backlash is compensated on one side only: rho's - direction."""
        return self.zero - self.sign * (self.offset - self.backlash / 2)

    def shown(self, travel: float, approach: int = 0) -> float:
        """What to command, in the controller's counting, for a true travel of the carriage.

        Args:
            travel: from mechanical zero along rho, metres.
            approach: direction of the last move along rho, +1 or -1; 0: the middle of the band.
        """
        lag = -approach * self.backlash / 2
        return self.zero + self.sign * (travel - self.offset - lag) * self.scale_factor


@dataclass(frozen=True)
class ControllerNumbers:
    """Corrections for the three drives.

    Attributes:
        name: of the machine.
        drives: x, y, z.
        left_over: parameters of the machine that no such number can hold.
    """

    name: str
    drives: tuple[DriveNumbers, DriveNumbers, DriveNumbers]
    left_over: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON; lengths in millimetres."""
        return {
            "machine": self.name,
            "drives": {d.leg: _entry(d) for d in self.drives},
            "not_held": list(self.left_over),
        }

    def text(self) -> str:
        """For people: the rules in words, one worked line, and a table."""
        first = self.drives[0]
        return _TEXT.format(
            name=self.name,
            worked=_worked(first),
            table="\n".join(_line(d) for d in self.drives),
            rest=_rest(self.left_over),
        )


def controller_numbers(machine: Machine) -> ControllerNumbers:
    """The corrections that a controller takes of a calibrated machine.

    Args:
        machine: calibrated; its ``[controller]`` says how the controller counts.
    """
    value, controller, geometry = machine.values, machine.spec.controller, machine.geometry
    drives = [
        DriveNumbers(
            leg,
            controller.sign[k],
            controller.zero[k],
            value.get(f"joint_offset.{leg}", 0.0),
            value.get(f"encoder_scale.{leg}", 0.0),
            value.get(f"backlash.{leg}", 0.0),
            geometry.L + value.get(f"leg_length.{leg}", 0.0),
        )
        for k, leg in enumerate(LEGS)
    ]
    rest = (n for n, v in value.items() if v and n.partition(".")[0] not in _LEFT_OVER)
    return ControllerNumbers(machine.spec.name, (drives[0], drives[1], drives[2]), tuple(rest))


def _mm(metres: float) -> float:
    return round(metres * 1e3, 6) + 0.0


def _entry(d: DriveNumbers) -> dict[str, Any]:
    return {
        "sign": d.sign,
        "old_zero_mm": _mm(d.zero),
        "new_zero_mm": _mm(d.new_zero),
        "add_to_command_mm": _mm(d.correction),
        "scale_factor": round(d.scale_factor, 9),
        "backlash_mm": _mm(d.backlash),
        "new_zero_one_sided_mm": _mm(d.one_sided_zero),
        "bar_length_mm": _mm(d.bar_length),
    }


def _line(d: DriveNumbers) -> str:
    return (
        f"  {d.leg}   {_mm(d.new_zero):+12.4f} {_mm(d.correction):+12.4f} "
        f"{d.scale_factor:13.7f} {_mm(d.backlash):10.4f} {_mm(d.one_sided_zero):+14.4f} "
        f"{_mm(d.bar_length):12.4f}"
    )


def _worked(d: DriveNumbers) -> str:
    way = "away from" if d.sign > 0 else "toward"
    side = "out" if d.offset >= 0 else "in"
    return (
        f"joint_offset.{d.leg} = {_mm(d.offset):+.4f} mm: told to be at mechanical zero, shown "
        f"{_mm(d.zero):.4f}, carriage {d.leg} stands {abs(_mm(d.offset)):.4f} mm too far {side}. "
        f"The controller counts {way} the origin (sign {d.sign:+d}), so the carriage is at "
        f"mechanical zero where it shows {_mm(d.zero):.4f} - ({d.sign:+d}) x "
        f"({_mm(d.offset):+.4f}) = {_mm(d.new_zero):.4f} mm: enter that as the zero, or add "
        f"{_mm(d.correction):+.4f} mm to every command of drive {d.leg}."
    )


def _rest(names: tuple[str, ...]) -> str:
    if not names:
        return "Nothing else was identified: these numbers hold all of it."
    return (
        "These numbers cannot hold " + ", ".join(names) + ": send commands from "
        "`orthoglide compensate` instead, which hold everything. Use one or the other, never both."
    )


_TEXT = """Numbers for the controller: {name}
All lengths in mm, in the controller's own counting.

The rule. A positive joint_offset means that the carriage stands farther from the origin than told.
To put it right the command must be less along rho by that much:
new zero = old zero - sign x joint_offset.
Worked: {worked}

Scale factor: multiply commanded distances from mechanical zero (or the counts per millimetre) by
it; the new zero is the one after that.
Backlash: the carriage lags half of it behind either move, and the offset is the middle of the band.
A controller that shifts by half each way takes "backlash" and "new zero". One that adds the whole
in one direction only (taken here: moves toward smaller rho go farther by it) takes "backlash" and
"one-sided zero".
Bar length: L of that leg, where the controller computes the kinematics.

drive    new zero  add to cmd.  scale factor   backlash one-sided zero   bar length
{table}

{rest}
"""
