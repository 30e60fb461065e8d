"""The numbers a controller takes of a calibrated machine, with the sign rule written out."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import TextWrapper
from typing import Any

import numpy as np

from orthoglide.accuracy import ExpectedError, expected_error, tool_settings
from orthoglide.add_ons import Paste, add_on_of
from orthoglide.control.acting import not_withheld
from orthoglide.control.checking import COUNTING, ZeroCheck, check_zeros
from orthoglide.effects import OF_DRIVES
from orthoglide.effects.wording import by_effect
from orthoglide.frames import Framed
from orthoglide.layout import ORTHOGLIDE, LegNames
from orthoglide.machine import Machine, MachineSource

_fill = TextWrapper(100, break_on_hyphens=False, break_long_words=False).fill
_RULE = (
    "{sum} what the controller shows, counted as now, when "
    "the carriage is at mechanical zero; for it stands at the commanded joint coordinate plus its "
    "{words}. Enter the new zero once, or add new zero - old zero to every command; never "
    "both."
).format
RULE = _RULE(sum="new zero = old zero - sign x joint offset:", words="joint offset")
"""The sign of a zero, wherever one is given."""
_RULE_BEST = _RULE(
    sum="new zero = old zero - sign x offset:",
    words="offset, here the one that {best} make up for best",
)
_ZEROS = "zeros alone"


@dataclass(frozen=True)
class DriveNumbers:
    """What one drive's controller takes, in its own counting.

    The carriage stands at ``s = (1 + scale) c + offset`` from mechanical zero where the controller
    commands ``c = sign (shown - zero)``; with lost motion B, ``B/2`` behind the last move.
    """

    leg: str  # its name
    sign: int  # +1 where the controller counts away from the origin, else -1
    zero: float  # what it showed at mechanical zero as the machine file says, metres
    offset: float  # joint offset, or what the numbers given make up for best, metres
    scale: float  # relative scale error
    backlash: float  # lost motion, metres
    bar_length: float  # mean length of the leg's bars, metres
    best: str = ""  # what the offset is the best of; empty of the joint offset itself
    identified: float = 0.0  # joint offset as identified, metres

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

    def as_dict(self) -> dict[str, Any]:
        """For JSON; lengths in millimetres."""
        return {
            "sign": self.sign,
            **({"offset_mm": _mm(self.offset)} if self.best else {}),
            **({} if self.best == _ZEROS else {"joint_offset_mm": _mm(self.identified)}),
            "old_zero_mm": _mm(self.zero),
            "new_zero_mm": _mm(self.new_zero),
            "add_to_command_mm": _mm(self.correction),
            "scale_factor": round(self.scale_factor, 9),
            "backlash_mm": _mm(self.backlash),
            "new_zero_one_sided_mm": _mm(self.one_sided_zero),
            "bar_length_mm": _mm(self.bar_length),
        }

    def worked(self, names: LegNames) -> str:
        """The sign rule for this drive, number by number, in a layout's words."""
        way, side = names.ways[self.sign > 0][1], names.ways[_mm(self.offset) >= 0][0]
        if self.best:
            what = (
                f"zero correction {self.leg} = {_mm(self.correction):+.4f} mm: with {self.best} "
                f"the tool is off least as if,"
            )
        else:
            what = f"joint offset {self.leg} = {_mm(self.offset):+.4f} mm:"
        return (
            f"{what} sent to mechanical zero, shown "
            f"{_mm(self.zero):.4f}, carriage {self.leg} stands {abs(_mm(self.offset)):.4f} mm too "
            f"far {side}. The controller counts {way} (sign {self.sign:+d}), so the "
            f"carriage is at mechanical zero where it shows {_mm(self.zero):.4f} - "
            f"({self.sign:+d}) x ({_mm(self.offset):+.4f}) = {_mm(self.new_zero):.4f} mm: enter "
            f"that as the zero, or add {_mm(self.correction):+.4f} mm to every command of drive "
            f"{self.leg}."
        )


@dataclass(frozen=True)
class ControllerNumbers(Framed):
    """Corrections for the three drives.

    Attributes:
        name: of the machine.
        names: of its legs.
        drives: of the three legs.
        left_over: parameters of the machine that no such number can hold.
        zeros_only: zeros for a controller that takes nothing else, metres.
        checks: readings that prove the sign of each new zero.
        expected: errors of the TCP, by what is corrected.
        firmware: numbers of the firmware that a machine was imported from, which then are given in
            the place of all others; ``None`` of another machine.
        calibrated: whether the machine file has any parameter at all.
    """

    name: str
    names: LegNames
    drives: tuple[DriveNumbers, DriveNumbers, DriveNumbers]
    left_over: tuple[str, ...]
    zeros_only: tuple[float, ...]
    checks: tuple[ZeroCheck, ...]
    expected: dict[str, ExpectedError]
    firmware: Paste | None = None
    calibrated: bool = True
    _index = "drive"

    def __repr__(self) -> str:
        return f"<{self.title}>"

    def __str__(self) -> str:
        return self.text()

    @property
    def rule(self) -> str:
        """The sign of a zero."""
        best = self.drives[0].best
        return _RULE_BEST.format(best=best) if best else RULE

    @property
    def title(self) -> str:
        """What they are, with the machine's name where it has one."""
        taker = "firmware" if self.firmware else "controller"
        return f"Numbers for the {taker}{f': {self.name}' if self.name else ''}"

    @property
    def columns(self) -> dict[str, list[Any]]:
        """A row a drive, in millimetres; or the firmware's numbers."""
        if self.firmware:
            return self.firmware.columns
        rows = [{"drive": d.leg, **d.as_dict()} for d in self.drives]
        return {name: [row[name] for row in rows] for name in rows[0]}

    @property
    def beyond(self) -> tuple[str, ...]:
        """What no such number can hold: parameters, several of one effect by its name."""
        return by_effect(self.left_over)

    def as_dict(self) -> dict[str, Any]:
        """For JSON; lengths in millimetres."""
        if self.firmware:
            return {"machine": self.name, "firmware": dict(self.firmware.facts)}
        return {
            "machine": self.name,
            "rule": self.rule,
            "drives": {d.leg: d.as_dict() for d in self.drives},
            "zeros_only_mm": {
                d.leg: _mm(v) for d, v in zip(self.drives, self.zeros_only, strict=True)
            },
            "checks": {c.drive: c.as_dict() for c in self.checks},
            "expected": {name: error.as_dict() for name, error in self.expected.items()},
            "not_held": list(self.left_over),
        }

    def text(self) -> str:
        """For people: the rule in words, one worked line, a table, and the checks."""
        if self.firmware:
            told = (t if "\n" in t else _fill(t) for t in self.firmware.paragraphs)
            return "\n\n".join((self.title, *told)) + "\n"
        shape = {name: f"{error.shape * 1e3:.4f}" for name, error in self.expected.items()}
        named = zip(self.drives, self.zeros_only, strict=True)
        alone = [f"{d.leg} {_mm(v):.4f}" for d, v in named]
        whole = (
            "" if self.drives[0].best == _ZEROS else f"{shape['numbers']} with the whole table, "
        )
        return _TEXT.format(
            title=self.title,
            rule=_fill(self.rule),
            worked=_fill(f"Worked: {self.drives[0].worked(self.names)}"),
            table="\n".join(map(_line, self.drives)),
            checks="\n".join(map(_fill, (_CHECKS, *(f"- {c}" for c in self.checks))))
            if self.checks
            else (_NONE if self.names == ORTHOGLIDE.names else _fill(_UNDIALLED)),
            alone=_fill(_ALONE.format(alone=", ".join(alone), whole=whole, **shape))
            if self.calibrated
            else "",
            rest=_rest(self.beyond) if self.calibrated else _fill(_NOMINAL),
        )


def controller_numbers(
    machine: MachineSource, *, zeros_only: bool = False, force: bool = False
) -> ControllerNumbers:
    """The corrections that a controller takes of a calibrated machine.

    Scales, lost motion and lengths are as identified; where the machine has more errors than that,
    the zeros are those that leave the least shape error over the workspace beside them.

    Args:
        machine: calibrated, or the path of its file; its ``[controller]`` says how the
            controller counts.
        zeros_only: for a controller that takes zeros and nothing else.
        force: give them whatever the verdict that is kept with the machine says.

    Raises:
        InputError: where the verdict says not to act on the machine's numbers.
    """
    machine = not_withheld(machine, force)
    settings = tool_settings(machine)
    alone = _by_kind(machine, settings["zeros"])["zero"]
    held = _by_kind(machine, settings["zeros" if zeros_only else "numbers"])
    of = machine.catalogue.effect_of
    left_over = [n for n, v in machine.values.items() if v and of(n).controller not in held]
    fitted = left_over or machine.geometry.layout.hanging  # which leaves the tool at its height
    best = _ZEROS if zeros_only else "these numbers" if fitted else ""
    identified = _by_kind(machine, machine.values).get("zero", np.zeros(3))
    controller, length = machine.spec.controller, machine.geometry.L
    firmware = add_on_of(machine.spec.provenance)
    none = np.zeros(3)
    drives = [
        DriveNumbers(
            leg,
            controller.sign[k],
            controller.zero[k],
            float(held.get("zero", none)[k]),
            float(held.get("scale", none)[k]),
            float(held.get("backlash", none)[k]),
            length + float(held.get("bar_length", none)[k]),
            best,
            float(identified[k]),
        )
        for k, leg in enumerate(machine.geometry.leg_names)
    ]
    return ControllerNumbers(
        machine.spec.name,
        machine.geometry.layout.names,
        (drives[0], drives[1], drives[2]),
        tuple(left_over),
        tuple((np.array(controller.zero) - np.array(controller.sign) * alone).tolist()),
        check_zeros(machine, held.get("zero", none)),
        {name: expected_error(machine, given) for name, given in settings.items()},
        None if firmware is None else firmware.paste(machine),
        bool(machine.spec.parameters),
    )


def _by_kind(machine: Machine, values: dict[str, float]) -> dict[str, np.ndarray]:
    """What a controller takes of these parameters: by kind of number, for x, y, z ``(3,)``, SI."""
    found: dict[str, np.ndarray] = {}
    for name, value in values.items():
        kind = machine.catalogue.effect_of(name).controller
        if kind in OF_DRIVES:
            leg = machine.geometry.leg_names.index(machine.catalogue.parameter(name).leg)
            found.setdefault(kind, np.zeros(3))[leg] += value
    return found


def _mm(metres: float) -> float:
    return round(metres * 1e3, 6) + 0.0


def _cell(metres: float, form: str) -> str:
    """Millimetres in a table; nothing is below zero that rounds to it."""
    return format(round(metres * 1e3, 4) + 0.0, form)


def _line(d: DriveNumbers) -> str:
    return (
        f"  {d.leg}   {_cell(d.new_zero, '+12.4f')} {_cell(d.correction, '+12.4f')} "
        f"{d.scale_factor:13.7f} {_cell(d.backlash, '10.4f')} "
        f"{_cell(d.one_sided_zero, '+14.4f')} {_cell(d.bar_length, '12.4f')}"
    )


def _rest(names: tuple[str, ...]) -> str:
    if not names:
        return "Nothing else was identified: these numbers hold all of it."
    return _fill(
        f"These numbers cannot hold {', '.join(names)}: send commands from `orthoglide compensate` "
        "instead, which hold all that the machine file has. Use one or the other, never both."
    )


_NONE = "Check of the signs: no zero moves by what a dial on a leg shows."
_UNDIALLED = (
    "Check of the signs: no dial is set against the legs of this machine: enter them with the tool "
    "well clear, then read the tool again as for the calibration. A zero with the wrong sign "
    "doubles what was off."
)
_NOMINAL = (
    "The machine file holds no calibration: these are its nominal numbers, and nothing is known of "
    "how far the real machine is off. Give the calibrated.toml of a result."
)
_CHECKS = f"Check of the signs. Enter the three new zeros and nothing else; {COUNTING}."

_ALONE = (
    "Zeros only. For a controller that takes nothing but zeros these are best: {alone}. Mean error "
    "of the TCP over the workspace to expect, after one translation of everything: {now} now, "
    "{zeros} with these zeros, {whole}{compensated} with commands from `orthoglide compensate`."
)

_TEXT = """{title}
All lengths in mm, in the controller's own counting.

{rule}
{worked}

Scale factor: multiply commanded distances from mechanical zero (or the counts per millimetre) by
it; the new zero is the one after that.
Backlash: the carriage lags half of it behind either move, and the offset is the middle of the band.
A controller that shifts by half each way takes "backlash" and "new zero". One that adds the whole
in one direction only (taken here: moves toward smaller commands go farther) takes "backlash" and
"one-sided zero".
Bar length: L of that leg, where the controller computes the kinematics.

drive    new zero  add to cmd.  scale factor   backlash one-sided zero   bar length
{table}

{checks}

{alone}

{rest}
"""
