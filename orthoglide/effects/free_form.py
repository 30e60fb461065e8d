"""Places: parts of the machine that may move in a way that no effect knows.

A place is a free function that moves virtual joints of one leg. Level and slope are left in: the
effects of the catalogue compete with them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal

from orthoglide.effects.effect import Effect
from orthoglide.effects.kernels import BuildUp, Bump, Jump, Kernel, Level
from orthoglide.effects.motions import LegConditions, Motion
from orthoglide.effects.words import Words, toward
from orthoglide.geometry import LEGS
from orthoglide.layout import LegNames, Orthoglide
from orthoglide.numerals import compact
from orthoglide.units import MM, RAD

Dependence = Literal["travel", "approach", "reversal", "command", "time", "reading"]
Part = Literal["drive", "rail", "carriage", "bar", "platform", "dial"]
Joints = tuple[tuple[str, float], ...]
Range = tuple[float, float]
FreeFunctions = Kernel | BuildUp | Bump | Jump | Level


@dataclass(frozen=True)
class FreeForm:
    """Where the machine may move as nothing in the catalogue does."""

    part: Part  # of the leg
    leg: int  # 0, 1 or 2; -1 of all dials together
    joints: Joints  # virtual joints that move, each with its share
    direction: str  # that it moves in or turns about, as a letter of the base; empty for none
    against: Dependence  # what it depends on
    command_drive: int  # the drive whose command it depends on, with `against` `"command"`
    variable: Callable[[LegConditions], Any]  # in [-1, 1], of the leg's conditions
    kernel: FreeFunctions  # how smooth it is
    prior_sd: float  # standard deviation to expect of a place that is wrong, SI
    # first and last of its variable, seconds or metres; `None`: the stroke
    span: Range | None = None
    setup: str = ""  # the dial's mounting; empty where it is all of them, or no dial
    names: LegNames = Orthoglide.names  # of legs and directions
    short_waves: bool = (
        False  # whether it comes and goes over a few centimetres, however long the stroke
    )
    bump: float | None = None  # travel, or a dial's reading, of a bump, metres; `None`: it is none
    jump: float | None = None  # second at which it jumps; `None`: it does not
    chance: float = 1.0  # how often it goes wrong, over other places

    @property
    def name(self) -> str:
        """Unique, such as ``rail.x.y/travel``."""
        if self.bump is not None:
            return f"{self.location_key}@{round(self.bump * 1e3, 2 if self.of_dial else 1):g}"
        if self.jump is not None:
            return f"{self.location_key}@{self.jump:.0f}s"
        return (
            self.location_key.replace("/travel", "/waves")
            if self.short_waves
            else self.location_key
        )

    @property
    def location_key(self) -> str:
        """Key that short and long variants share, as only one of them can be the cause."""
        if self.of_dial:
            return f"dial{self.setup and '.'}{self.setup}/{self.against}"
        way = f".{self.direction}" if self.direction else ""
        by = f".{self.names.legs[self.command_drive]}" if self.against == "command" else ""
        leg = f".{self.names.legs[self.leg]}" if self.leg >= 0 else ""
        return f"{self.part}{leg}{way}/{self.against}{by}"

    @property
    def is_local(self) -> bool:
        """Whether it is wrong at one place or moment alone."""
        return self.bump is not None or self.jump is not None

    @property
    def is_rotation(self) -> bool:
        """Whether it rotates a part; else it moves or stretches one."""
        return self.part == "carriage"

    @property
    def of_dial(self) -> bool:
        """Whether it is a dial's, or that of all dials, and nothing of the machine."""
        return self.part == "dial"

    @property
    def of_machine(self) -> bool:
        """Whether a calibrated machine keeps it: what changes with time is the campaign's."""
        return self.in_model and self.against != "time"

    @property
    def in_model(self) -> bool:
        """Whether the machine's own model can have it: it knows commands and conditions, not the
        way that led there, and no joints at the platform that move.
        """
        return self.against != "reversal" and not (self.of_dial or self.moves_bar_ends)

    @property
    def moves_bar_ends(self) -> bool:
        """Whether the bars of its leg move along with it, as a dial on them shows.

        The leg's end on the platform moves by as much as the joints, which are the carriage's, move
        the other way: to the rest of the machine it is the same.
        """
        return self.part == "platform"

    @property
    def depends_on_approach(self) -> bool:
        """Whether the way that led there decides: its level counts, none of it is of a zero."""
        return self.against in ("approach", "reversal")

    @property
    def loses(self) -> bool:
        """Whether it is lost motion: the same command ends elsewhere by the way that led there."""
        return self.depends_on_approach and not self.of_dial

    def interval(self, stroke: Range) -> Range:
        """First and last of its variable, on a machine of some stroke, metres."""
        return (0.0, stroke[1] - stroke[0]) if self.against == "reversal" else self.span or stroke

    @cached_property
    def effect(self) -> Effect:
        """The same as an effect, for a machine that has it: a parameter a coefficient."""
        unit = RAD if self.is_rotation else MM
        words = self.words
        return Effect(
            re.sub(r"\W", "_", self.name),  # a setup may be called anything
            unit,
            self.prior_sd / unit.si,
            because="what no known shape explains is a few hundredths",
            sentence=words,
            look_at=self.look_at,
            members=partial(_members, self),
            words=Words(many=words),
            paired=True,
            names=self.names,
        )

    @property
    def words(self) -> str:
        """Clause with the location and the kind of the error."""
        if self.of_dial and not self.setup:
            return "all dials read more or less by the way that their plungers came"
        if self.part == "drive" and self.leg < 0:
            return "all drives go wrong along their axes alike with time"
        if self.of_dial:
            what = {
                "time": "creeps with time",
                "reading": "is not true over its range",
                "approach": "reads more or less by the way that its plunger came",
            }[self.against]
            if self.bump is not None:
                what = "is wrong at one place of its range and nowhere else"
            return f"the dial of {self.setup} {what}"
        leg = self.names.legs[self.leg]
        how = {
            "travel": self._travel_words,
            "approach": "by the side it is approached from",
            "reversal": "by the way gone since it turned round",
            "command": f"by the command of drive {self.names.legs[self.command_drive]}",
            "time": "with time" if self.jump is None else f"at {self.jump:.0f} s, at once",
        }[self.against]
        what = {
            "drive": f"drive {leg} goes wrong along its axis",
            "rail": f"the path of the {leg} carriage leaves its line toward "
            f"{toward(self.direction, 1.0)}",
            "carriage": f"the {leg} carriage turns about {self.direction}",
            "bar": f"bar {self.direction} of leg {leg} changes its length"
            if self.direction
            else f"both bars of leg {leg} change their length",
            "platform": f"the end of leg {leg} moves on the platform toward "
            f"{toward(self.direction, 1.0)}",
        }[self.part]
        return self.names.in_layout_words(f"{what} {how}")

    @property
    def _travel_words(self) -> str:
        if self.bump is not None:
            return f"at travel {compact(self.bump * 1e3, 3)} mm and nowhere else"
        return "in short waves along its travel" if self.short_waves else "by its travel"

    @property
    def look_at(self) -> str:
        """What to look at on the machine."""
        if self.of_dial:
            return "the dial against gauge blocks, and its stand"
        if self.leg < 0:
            return "what warms all drives alike: the room, the motors, the machine's frame"
        leg = self.names.legs[self.leg]
        part = {
            "drive": f"the drive of axis {leg}: screw or belt, coupling, encoder",
            "rail": f"the rail of axis {leg}, straight edge and dial along its travel",
            "carriage": f"the carriage of axis {leg}: its bearings and preload",
            "bar": f"the bars of leg {leg}, their pivots and their warmth",
            "platform": f"the joint of leg {leg} at the platform: its pins and their fit",
        }[self.part]
        return self.names.in_layout_words(part)

    def functions(self, conditions: LegConditions, which: slice = slice(None)) -> list[Any]:
        """The free functions at some conditions, each for a coefficient of sd ``unit``."""
        if self.against == "reversal":
            return list(conditions.built_up[which])
        values = self.kernel.functions(self.variable(conditions), which)
        if self.against == "approach":
            return [value * conditions.approach / 2 for value in values]
        return values


def _members(place: FreeForm, leg: int) -> Mapping[str, tuple[Motion, ...]]:
    """A place as the members of an effect: a parameter a coefficient."""
    if leg != place.leg:
        return {}
    return {
        str(k + 1): tuple(Motion(j, partial(_basis, place, k, share)) for j, share in place.joints)
        for k in range(place.kernel.count)
    }


def _basis(place: FreeForm, k: int, share: float, conditions: LegConditions) -> Any:
    return share * place.functions(conditions, slice(k, k + 1))[0]


def travel_variable(c: LegConditions) -> Any:
    """Return where a carriage stands, from -1 to 1 over the stroke."""
    return c.u


def command_variable(leg: int, c: LegConditions) -> Any:
    """Return where a drive is told to stand, from -1 to 1 over the stroke."""
    low, high = c.stroke
    travel = c.commands[leg] - c.command + c.nominal_travel
    return (travel - (low + high) / 2) / ((high - low) / 2)


def _time_variable(start: float, end: float, c: LegConditions) -> Any:
    """Time within a session as -1 to 1, held outside it."""
    half = max((end - start) / 2, 1e-9)
    u = (c.time - start) / half - 1
    return (abs(u + 1) - abs(u - 1)) / 2  # within -1 and 1, of symbols too


_LENGTH = 0.08  # metres: half of the stroke at which the lengths below were written
_FINE, _COARSE = Kernel(0.030 / _LENGTH, 12), Kernel(0.050 / _LENGTH, 8)
# A coupling slips, an encoder misses a count, a carriage sticks and jumps: down to 2 mm.
_DRIVE, _LOST = Kernel(0.030 / _LENGTH, 96, rough=0.1), Kernel(0.030 / _LENGTH, 24, rough=0.1)
# Harmonics of a screw, a worn ball: between stations that are farther apart nothing is known.
_SCREW = Kernel(0.003 / _LENGTH, 96)
_ACROSS = Kernel(0.050 / _LENGTH, 8, line=True)
_OU = Kernel(1 / 3, 24, rough=1.0)  # a sixth of the session
_DRIFT = Kernel(0.5, 12, rough=0.1)  # warmth comes and goes slowly, and begins at once
# Rollers, and a profile that was pressed or printed: waves of some centimetres, however long the
# stroke. On one of less than three waves of this kind the lengths above draw them as well.
_SHORT, _SHORT_FROM = 0.015, 1.5 * _LENGTH
_PER_LENGTH, _MOST = 5, 96  # functions of half a stroke as long as a correlation length; in all
# The leg's end does not know where the carriage stands, and a rail that is wrong shows
# nearly the same.
_PLATFORM_PRIOR_WEIGHT = 0.1
BUILD_UP = BuildUp((0.05, 0.1, 0.2, 0.4, 0.8))
_CREEP, _DIAL = Kernel(0.5, 8, rough=1.0), Kernel(0.5, 6)
_UM = 1e-6


@dataclass(frozen=True)
class Session:
    """The time in which something was measured."""

    start: float  # first second
    end: float  # last second
    leg: int | None = None  # whose dials were read; `None`: of the whole campaign


def _short_wave_kernel(half: float) -> Kernel:
    """What comes and goes over some centimetres, on a stroke of twice ``half``, metres."""
    return Kernel(_SHORT / half, min(_MOST, math.ceil(_PER_LENGTH * half / _SHORT)))


def free_forms(
    sessions: Sequence[Session] = (),
    names: LegNames = Orthoglide.names,
    stroke: Range = (-_LENGTH, _LENGTH),
    scale: float = 1.0,
) -> tuple[FreeForm, ...]:
    """Return all places of a machine.

    Args:
        sessions: of each leg, and of the campaign; none where time was not recorded.
        names: of legs and directions.
        stroke: travel limits of the machine, metres.
        scale: of its size, that of a workshop being 1.
    """
    half = (stroke[1] - stroke[0]) / 2
    found: list[FreeForm] = []
    for leg in range(len(LEGS)):
        own = names.legs[leg]
        drive, across = (("travel", 1.0),), dict(zip("bc", names.across[leg], strict=True))

        def add(part: Part, joints: Joints, direction: str, against: Dependence, variable: Any,
                kernel: FreeFunctions, unit: float, by: int = 0, leg: int = leg) -> None:  # fmt: skip
            rare = part == "platform" and against == "travel"
            place = FreeForm(part, leg, joints, direction, against, by, variable, kernel, unit,
                          chance=_PLATFORM_PRIOR_WEIGHT if rare else 1.0)  # fmt: skip
            found.append(place)
            if part in ("rail", "carriage") and against == "travel" and half > _SHORT_FROM:
                found.append(replace(place, kernel=_short_wave_kernel(half), short_waves=True))
            if part == "drive" and against == "travel":
                found.append(replace(place, kernel=_SCREW, short_waves=True))

        add("drive", drive, "", "travel", partial(command_variable, leg), _DRIVE, 100 * _UM)
        add("drive", drive, "", "approach", partial(command_variable, leg), _LOST, 50 * _UM)
        add("drive", drive, "", "reversal", _no_variable, BUILD_UP, 50 * _UM)
        for other in range(len(LEGS)):
            if other != leg:
                by = partial(command_variable, other)
                add("drive", drive, "", "command", by, _ACROSS, 50 * _UM, other)
        for axis, letter in across.items():
            sideways = ((f"lateral_{axis}", 1.0),)
            add("rail", sideways, letter, "travel", travel_variable, _FINE, 50 * _UM)
            add("rail", sideways, letter, "approach", travel_variable, _COARSE, 50 * _UM)
            end = ((f"lateral_{axis}", -1.0),)
            add("platform", end, letter, "travel", travel_variable, _FINE, 50 * _UM)
            add("platform", end, letter, "approach", travel_variable, _COARSE, 50 * _UM)
        # A leg may be called as one of its directions: then its slide is, as its frame has it, a.
        slide = "a" if own in across.values() else own
        for axis, letter in {"a": slide, **across}.items():
            add(
                "carriage",
                ((f"turn_{axis}", 1.0),),
                letter,
                "travel",
                travel_variable,
                _ACROSS,
                1e-3,
            )
        for bar in "12":
            add(
                "bar",
                ((f"stretch{bar}", 1.0),),
                bar,
                "approach",
                travel_variable,
                _COARSE,
                50 * _UM,
            )
    found += (place for session in sessions for place in _time_dependent_forms(session))
    return tuple(scaled_to_machine(replace(place, names=names), scale) for place in found)


def _time_dependent_forms(session: Session) -> Iterator[FreeForm]:
    """What changes in a session: bars of the leg that is read, drives in the whole campaign."""
    span, whole = (session.start, session.end), session.leg is None
    variable, kernel = partial(_time_variable, *span), _DRIFT if whole else _OU

    def place(part: Part, leg: int, joints: Joints, way: str, unit: float) -> FreeForm:
        return FreeForm(part, leg, joints, way, "time", 0, variable, kernel, unit, span)

    if session.leg is None:
        for leg in (-1, *range(len(LEGS))):
            yield place("drive", leg, (("travel", 1.0),), "", 100 * _UM)
        return
    both = (("stretch1", 1.0), ("stretch2", 1.0))
    for joints, way in ((both[:1], "1"), (both[1:], "2"), (both, "")):
        yield place("bar", session.leg, joints, way, 50 * _UM)


def scaled_to_machine(place: FreeForm, scale: float) -> FreeForm:
    """Return a place with what to expect of it on a machine of some size; parts of any size turn by
    the same angles.
    """
    return place if place.is_rotation else replace(place, prior_sd=place.prior_sd * scale)


def dial_free_forms(
    setup: str, leg: int, time: Range | None, reading: Range, turns: bool, scale: float = 1.0
) -> tuple[FreeForm, ...]:
    """Places of one mounting of a dial: its creep, its curve, and its reversal error.

    Args:
        setup: the mounting.
        leg: that it touches.
        time: first and last second; ``None`` where it was not recorded.
        reading: smallest and largest predicted reading, metres: a curve by what was measured
            would fit its own noise.
        turns: whether its plunger came both ways.
        scale: of the machine's size, for which dials are chosen.
    """
    every: tuple[tuple[Dependence, FreeFunctions, float, Range | None], ...] = (
        ("time", _CREEP, 20 * _UM, time),
        ("reading", _DIAL, 20 * _UM, reading),
        ("approach", Level(), 10 * _UM, reading if turns else None),
    )
    return tuple(
        FreeForm("dial", leg, (), "", against, 0, _no_variable, kernel, unit * scale, span, setup)
        for against, kernel, unit, span in every
        if span is not None
    )


def common_dial_form(reading: Range, scale: float = 1.0) -> FreeForm:
    """Dials of one make, which read by the way that their plungers came, all by as much, over some
    range of readings, metres, on a machine of some size.
    """
    return FreeForm(
        "dial", -1, (), "", "approach", 0, _no_variable, Level(), 10 * _UM * scale, reading
    )


def _no_variable(c: LegConditions) -> Any:
    raise TypeError("this place is a function of no variable of the leg")
