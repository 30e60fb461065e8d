"""The numbers a controller takes of a calibrated machine, with the sign rule written out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from textwrap import TextWrapper
from typing import Any

import numpy as np

from orthoglide.accuracy import ExpectedError, expected_error, tool_settings
from orthoglide.add_ons import Paste
from orthoglide.arguments import public
from orthoglide.control.zero_checks import ZeroCheck, check_zeros, checked_for_use
from orthoglide.effects import DRIVE_ENTRIES
from orthoglide.frames import Framed
from orthoglide.layout import ORTHOGLIDE, LegNames
from orthoglide.machine import Machine, MachineSource
from orthoglide.numerals import MINUS, in_mm, mm_text, plain, signed
from orthoglide.ordering import RELATIVE_MARGIN, best_of, ranked
from orthoglide.parameters import effect_name
from orthoglide.text import listed, sentence

_fill = TextWrapper(100, break_on_hyphens=False, break_long_words=False).fill
_micrometres = partial(mm_text, decimals=3)  # millimetres, to a micrometre
RULE = (
    "Enter each new zero once, in place of the old one, or add new zero − old zero to every "
    "command of that drive; never both."
)
"""What to do with new zeros, wherever they are given."""
_FORMULA = (
    f"new zero = old zero {MINUS} sign × offset: what the controller shows, counted as now, when "
    "the carriage is at mechanical zero."
)
_ZEROS_ALONE = "zeros alone"
_MAX_NAMED = 2  # kinds of errors that a sentence names
_MIN_SCALE, _MIN_LENGTH = 5e-6, 5e-7  # less is a micrometre over 0.2 m; metres


@dataclass(frozen=True)
class Table:
    """A small table as text."""

    titles: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """Columns one beside the other, set to the right."""
        lines = (self.titles, *self.rows)
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "    ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
            for line in lines
        )


@dataclass(frozen=True)
class DriveNumbers:
    """What one drive's controller takes, in its own counting.

    The carriage stands at ``s = (1 + scale) c + offset`` from mechanical zero where the controller
    commands ``c = sign (shown - zero)``; with lost motion B, ``B/2`` behind the last move.
    """

    leg: str  # its name
    sign: int  # +1 where the controller counts away from the origin, else -1
    zero: float  # what it showed at mechanical zero as the machine file says, metres
    offset: float  # joint offset, or the best compromise with the numbers given, metres
    scale: float  # relative scale error
    backlash: float  # lost motion, metres
    bar_length: float  # mean length of the leg's bars, metres
    best: str = ""  # what the offset is the best of; empty of the joint offset itself
    identified: float = 0.0  # joint offset as identified, metres

    @property
    def new_zero(self) -> float:
        """What the controller is to show at mechanical zero, metres, its scale corrected."""
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

    def as_dict(self, zeros_alone: bool = False) -> dict[str, Any]:
        """Return the numbers for JSON, only zeros if ``zeros_alone``; lengths in millimetres."""
        zeros = {
            "sign": self.sign,
            **({"offset_mm": in_mm(self.offset)} if self.best else {}),
            "old_zero_mm": in_mm(self.zero),
            "new_zero_mm": in_mm(self.new_zero),
            "add_to_command_mm": in_mm(self.correction),
        }
        others = {
            "joint_offset_mm": in_mm(self.identified),
            "scale_factor": round(self.scale_factor, 9),
            "backlash_mm": in_mm(self.backlash),
            "new_zero_one_sided_mm": in_mm(self.one_sided_zero),
            "bar_length_mm": in_mm(self.bar_length),
        }
        return zeros if zeros_alone else zeros | others

    def worked(self, names: LegNames) -> str:
        """Return the sign rule with the numbers of this drive, in a layout's words."""
        direction = names.slide_end_words[self.sign > 0][1]
        side = names.slide_end_words[in_mm(self.offset) >= 0][0]
        stands = "stands on average" if self.best else "stands"
        old, sign, offset = plain(in_mm(self.zero), 3), signed(self.sign, 0), in_mm(self.offset)
        return (
            f"at the old zero {old} carriage {self.leg} {stands} "
            f"{abs(offset):.3f} mm too far {side}, and the controller counts {direction} "
            f"(sign {sign}): new zero = {old} {MINUS} ({sign}) × "
            f"({signed(offset, 3)}) = {plain(in_mm(self.new_zero), 3)} mm."
        )


@dataclass(frozen=True)
class ControllerNumbers(Framed):
    """Corrections for the three drives.

    Attributes:
        name: of the machine.
        names: of its legs.
        drives: of the three legs.
        left_over: parameters of the machine that no such number can hold, largest first.
        zeros_only: zeros for a controller that takes nothing else, metres.
        checks: readings that prove the sign of each new zero.
        expected: errors of the TCP, by what is corrected.
        firmware: numbers of the firmware that a machine was imported from, which then are given in
            the place of all others; ``None`` of another machine.
        calibrated: whether the machine file has any parameter at all.
    """

    name: str
    names: LegNames
    drives: tuple[DriveNumbers, ...]
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
        """Effects that no such number can hold, in words."""
        effects = dict.fromkeys(map(effect_name, self.left_over))
        return tuple(map(self.names.effect_words, effects))

    @property
    def zeros_alone(self) -> bool:
        """Whether these are numbers for a controller that takes zeros and nothing else."""
        return self.drives[0].best == _ZEROS_ALONE

    @property
    def zeros(self) -> Table:
        """The zeros to enter, old and new."""
        printed = [(d.leg, _micrometres(d.zero), _micrometres(d.new_zero)) for d in self.drives]
        rows = tuple(row for row in printed if row[1] != row[2])
        return Table((self.names.axis, "old zero", "new zero"), rows)

    @property
    def rule(self) -> str:
        """What to do with the new zeros, and which zeros stay."""
        moved = {leg for leg, *_ in self.zeros.rows}
        stay = [d.leg for d in self.drives if d.leg not in moved]
        axes = f"{self.names.axis.capitalize()} {listed(stay)}: the zero stays as it is."
        return " ".join([RULE] * bool(moved) + [axes] * bool(stay))

    @property
    def worked(self) -> str:
        """The sign rule worked for the axis whose zero moves most; empty where none does."""
        if not any(in_mm(d.correction) for d in self.drives):
            return ""
        moved_most = best_of(self.drives, lambda d: abs(d.correction))
        return f"{self.names.axis.capitalize()} {moved_most.leg}: {moved_most.worked(self.names)}"

    @property
    def settings(self) -> tuple[tuple[Table, str], ...]:
        """Further numbers, each with what it means; none that would change nothing."""
        drives, axis, bar = self.drives, self.names.axis, self.names.bar
        settings = []
        if any(abs(d.scale_factor - 1) > _MIN_SCALE for d in drives):
            scales = tuple((d.leg, f"{d.scale_factor:.6f}") for d in drives)
            settings.append((Table((axis, "scale factor"), scales), _SCALE_TEXT))
        if any(d.backlash > _MIN_LENGTH for d in drives):
            titles, text = (axis, "backlash", "one-sided zero"), _micrometres
            rows = tuple((d.leg, text(d.backlash), text(d.one_sided_zero)) for d in drives)
            settings.append((Table(titles, rows), _BACKLASH_TEXT))
        if not self.zeros_alone and self.calibrated:
            lengths = tuple((d.leg, _micrometres(d.bar_length)) for d in drives)
            settings.append((Table((axis, f"{bar} length"), lengths), _LENGTH_TEXT.format(bar)))
        return tuple(settings)

    @property
    def check(self) -> tuple[str, tuple[str, ...]]:
        """How the signs are checked, and a reading to expect for each axis, the plainest first."""
        if self.checks:
            ordered = ranked(self.checks, lambda check: abs(check.right - check.wrong))
            return _CHECKS_TEXT, tuple(sentence(str(check)) for check in ordered)
        return (_NO_CHECKS_TEXT if self.names == ORTHOGLIDE.names else _CHECKS_AT_TOOL_TEXT), ()

    @property
    def gains(self) -> str:
        """The tool's errors to expect, a sentence; empty where nothing is known of them."""
        if not self.calibrated:
            return ""
        stages = {"now": "now", "zeros" if self.zeros_alone else "numbers": "with these numbers",
                  "compensated": "with commands from orthoglide compensate"}  # fmt: skip
        errors = [f"{self.expected[k].words} mm {words}" for k, words in stages.items()]
        return f"Mean error of the tool after the best translation: {', '.join(errors)}."

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON; lengths in millimetres."""
        if self.firmware:
            return {"machine": self.name, "firmware": dict(self.firmware.facts)}
        return {
            "machine": self.name,
            "rule": f"{_FORMULA} {RULE}",
            "drives": {d.leg: d.as_dict(self.zeros_alone) for d in self.drives},
            "zeros_only_mm": {
                d.leg: in_mm(v) for d, v in zip(self.drives, self.zeros_only, strict=True)
            },
            "checks": {c.drive: c.as_dict() for c in self.checks},
            "expected": {name: error.as_dict() for name, error in self.expected.items()},
            "not_held": list(self.left_over),
        }

    def text(self) -> str:
        """Return the text for people: the rule in words, one worked line, a table, the checks."""
        if self.firmware:
            paragraphs = (t if "\n" in t else _fill(t) for t in self.firmware.paragraphs)
            return "\n\n".join((self.title, *paragraphs)) + "\n"
        instruction, readings = self.check
        proofs = [f"- {reading}" for reading in readings]
        parts = [
            f"{self.title}\nLengths in mm, as the controller counts.",
            *([self.zeros.text()] if self.zeros.rows else ()),
            _fill(self.rule),
            *([_fill(f"Example. {self.worked}")] if self.worked else ()),
            *(f"{_fill(meaning)}\n\n{table.text()}" for table, meaning in self.settings),
            *(["\n".join(map(_fill, (instruction, *proofs)))] if self.worked else ()),
            *map(_fill, filter(None, (self.gains, self.rest))),
        ]
        return "\n\n".join(parts) + "\n"

    @property
    def rest(self) -> str:
        """Errors that these numbers do not correct, and what corrects them, in sentences."""
        if not self.calibrated:
            return _NOMINAL_TEXT
        if not self.beyond:
            return "Nothing else was identified: these numbers correct all of it."
        named = list(self.beyond)
        if len(named) > _MAX_NAMED:
            named[_MAX_NAMED:] = [f"{len(named) - _MAX_NAMED} more"]
        hint = (
            " A controller that takes zeros alone needs other zeros, which the option --zeros-only "
            "of orthoglide export gives." * (not self.zeros_alone)
        )
        return (
            f"These numbers correct no other error that was identified ({listed(named)}); commands "
            f"from orthoglide compensate correct them too. Use one or the other, never both."
            f"{hint}"
        )


@public
def controller_numbers(
    machine: MachineSource, *, zeros_only: bool = False, force: bool = False
) -> ControllerNumbers:
    """Return the corrections of a calibrated machine that a controller can apply.

    Scales, lost motion and lengths are as identified. Where the machine has further errors, the
    zeros minimise the shape error over the workspace that these leave.

    Args:
        machine: calibrated, or the path of its file; its ``[controller]`` says how the
            controller counts.
        zeros_only: for a controller that takes zeros and nothing else.
        force: give them whatever the verdict that is kept with the machine says.

    Raises:
        InputError: where the verdict says not to act on the machine's numbers.
    """
    machine = checked_for_use(machine, force)
    settings, effect_of = tool_settings(machine), machine.catalogue.effect_of
    offsets_alone = _values_by_kind(machine, settings["zeros"])["zero"]
    numbers = _values_by_kind(machine, settings["zeros" if zeros_only else "numbers"])
    identified = _values_by_kind(machine, machine.values)["zero"]
    held = ("zero",) if zeros_only else DRIVE_ENTRIES
    others = [n for n, v in machine.values.items() if v and effect_of(n).controller not in held]
    left_over = ranked(
        others, lambda n: abs(machine.values[n]) / machine.tolerance(n), RELATIVE_MARGIN
    )
    # On a hanging layout the zeros leave the tool at its height.
    compromise = left_over or machine.geometry.layout.hanging
    best = _ZEROS_ALONE if zeros_only else "these numbers" if compromise else ""
    controller, printer = machine.spec.controller, machine.spec.printer
    drives = tuple(
        DriveNumbers(
            leg,
            controller.sign[k],
            controller.zero[k],
            float(numbers["zero"][k]),
            float(numbers["scale"][k]),
            float(numbers["backlash"][k]),
            machine.geometry.L + float(numbers["bar_length"][k]),
            best,
            float(identified[k]),
        )
        for k, leg in enumerate(machine.geometry.leg_names)
    )
    return ControllerNumbers(
        machine.spec.name,
        machine.geometry.layout.names,
        drives,
        tuple(left_over),
        tuple((np.array(controller.zero) - np.array(controller.sign) * offsets_alone).tolist()),
        check_zeros(machine, numbers["zero"]),
        {name: expected_error(machine, given) for name, given in settings.items()},
        None if printer is None else printer.paste(),
        bool(machine.spec.parameters),
    )


def _values_by_kind(machine: Machine, values: dict[str, float]) -> dict[str, np.ndarray]:
    """Return the numbers of these parameters that a controller takes, by kind: ``(3,)``, SI."""
    by_kind: dict[str, np.ndarray] = {kind: np.zeros(3) for kind in DRIVE_ENTRIES}
    for name, value in values.items():
        kind = machine.catalogue.effect_of(name).controller
        if kind in by_kind:
            leg = machine.geometry.leg_names.index(machine.catalogue.parameter(name).leg)
            by_kind[kind][leg] += value
    return by_kind


_SCALE_TEXT = (
    "Scale, where the controller has one: multiply commanded distances from mechanical zero (or "
    "the counts per millimetre) by the factor. The new zero is the one after that."
)
_BACKLASH_TEXT = (
    "Backlash, where the controller has a setting for it: one that shifts by half of it each way "
    "takes it with the new zero above. One that adds the whole in one direction only (taken here: "
    "moves toward smaller commands go farther) takes it with the one-sided zero."
)
_LENGTH_TEXT = "Length of the {}s, where the controller computes the kinematics."
_CHECKS_TEXT = (
    "Check the signs before the machine works again. With the new zeros entered and nothing else, "
    "send all axes to their new zeros and set the dial to 0; move them as the controller counts, "
    "and read the dial."
)
_NO_CHECKS_TEXT = "Dials on the legs cannot check the signs of these zeros."
_CHECKS_AT_TOOL_TEXT = (
    "Check of the signs: enter the zeros with the tool well clear, then read the tool again as for "
    "the calibration. A zero with the wrong sign doubles what was off."
)
_NOMINAL_TEXT = (
    "The machine file contains no calibration: these are its nominal numbers, and nothing is known "
    "of how far the real machine is off. Give the calibrated.toml of a result."
)
