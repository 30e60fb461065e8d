"""Where a free-form error is and on what it depends: the part, the variable, and its places."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from orthoglide.effects.kernels import BuildUp, Bump, Kernel, Level, Step, Wave
from orthoglide.layout import LegNames, Orthoglide
from orthoglide.numerals import compact

Dependence = Literal["travel", "approach", "reversal", "command", "time", "reading"]
Part = Literal["drive", "screw", "rail", "carriage", "bar", "platform", "dial"]
Range = tuple[float, float]
FreeFunctions = Kernel | BuildUp | Bump | Step | Level | Wave
_UM = 1e-6


@dataclass(frozen=True)
class FreeFormPlace:
    """A part of the machine that moves, and the variable of the free function by which it does."""

    part: Part  # of the leg
    leg: int  # 0, 1 or 2; -1 of all dials together
    axis: str  # of the leg, a, b or c, that it moves along or turns about; of a bar its number
    against: Dependence  # what it depends on
    kernel: FreeFunctions  # how smooth it is
    prior_sd: float = 50 * _UM  # prior standard deviation of its displacement, SI
    command_drive: int = 0  # the drive whose command it depends on, with `against` `"command"`
    # first and last of its variable, seconds or metres; `None`: the stroke
    span: Range | None = None
    setup: str = ""  # the dial's mounting; empty where it is all of them, or no dial
    names: LegNames = Orthoglide.names  # of legs and directions
    # whether it varies within a few centimetres, however long the stroke
    short_waves: bool = False
    bump: float | None = None  # travel, or a dial's reading, of a bump, metres; `None`: it is none
    wide: float = 0.0  # standard deviation of a wide bump, metres; 0 of a narrow one
    jump: Range | None = None  # moments or travels between which it jumps; `None`: it does not
    timed: bool = True  # whether moments are seconds; else they count the readings
    period: float | None = None  # of a wave along its travel, metres; `None`: it has no single one
    # from which it comes where it steps, with `against` `"approach"`: 1 smaller, -1 larger travel
    side: int = 0
    chance: float = 1.0  # prior weight relative to other free-form errors

    @property
    def direction(self) -> str:
        """The letter of the base for its axis; the number of a bar; else empty.

        Where a leg has the name of one of its directions, its slide is called a, as in its frame.
        """
        across = self.names.across[self.leg]
        slide = "a" if self.names.legs[self.leg] in across else self.names.legs[self.leg]
        return dict(zip("abc", (slide, *across), strict=True)).get(self.axis, self.axis)

    @property
    def joints(self) -> tuple[tuple[str, float], ...]:
        """Virtual joints of the leg that move, each with its share."""
        return {
            "drive": (("travel", 1.0),),
            "screw": (("travel", 1.0),),
            "rail": ((f"lateral_{self.axis}", 1.0),),
            "platform": ((f"lateral_{self.axis}", -1.0),),
            "carriage": ((f"turn_{self.axis}", 1.0),),
            "bar": tuple((f"stretch{bar}", 1.0) for bar in self.axis or "12"),
            "dial": (),
        }[self.part]

    @property
    def name(self) -> str:
        """Unique, such as ``rail.x.y/travel``."""
        if self.bump is not None:
            width = f"w{self.wide * 1e3:.0f}" if self.wide else ""
            spot = round(self.bump * 1e3, 2 if self.of_dial else 1)
            return f"{self.location_key}@{spot:g}{width}"
        if self.jump is not None:
            return f"{self.location_key}@{self.spot.replace(' ', '')}"
        if self.is_line:
            return f"{self.location_key}-line"
        period = f"@{self.period * 1e3:.4f}" if self.period else ""
        waves = f"/waves{period}" if self.short_waves else "/travel"
        return self.location_key.replace("/travel", waves)

    @property
    def location_key(self) -> str:
        """Key that the variants of one error share, as only one of them can be the cause."""
        if self.of_dial:
            return f"dial{self.setup and '.'}{self.setup}/{self.against}"
        direction = f".{self.direction}" if self.direction else ""
        drive = f".{self.names.legs[self.command_drive]}" if self.against == "command" else ""
        leg = f".{self.names.legs[self.leg]}" if self.leg >= 0 else ""
        return f"{self.part}{leg}{direction}/{self.against}{drive}"

    @property
    def is_local(self) -> bool:
        """Whether it is wrong at one place or moment alone."""
        return self.bump is not None or self.jump is not None

    @property
    def is_variant(self) -> bool:
        """Whether it is one of many of its part, at one place, moment or period: `chance` is its
        whole prior weight.
        """
        return self.is_local or self.period is not None

    @property
    def is_line(self) -> bool:
        """Whether it is proportional to its variable, as one shape of a wider free function."""
        return isinstance(self.kernel, Kernel) and self.kernel.waves == 0

    @property
    def is_step(self) -> bool:
        """Whether it is a step along the travel; its second coefficient is that of its place."""
        return self.jump is not None and self.against != "time"

    @property
    def only_if_active(self) -> bool:
        """Whether it is no part of the background, whose smooth functions contain such shapes."""
        return any((self.jump, self.wide, self.period, self.is_line))

    @property
    def is_rotation(self) -> bool:
        """Whether it rotates a part; else it moves or stretches one."""
        return self.part == "carriage"

    @property
    def of_dial(self) -> bool:
        """Whether it belongs to one dial or to all dials, and not to the machine."""
        return self.part == "dial"

    @property
    def of_machine(self) -> bool:
        """Whether a calibrated machine keeps it. Slow changes with time belong to the campaign;
        after a jump the machine stays as it is.
        """
        return self.in_model and (self.against != "time" or self.jump is not None)

    @property
    def in_model(self) -> bool:
        """Whether the model of a machine can contain it: that model knows commands and conditions,
        but neither the path since the last reversal nor moving joints at the platform.
        """
        return self.against != "reversal" and not (self.of_dial or self.moves_bar_ends)

    @property
    def has_one_shape(self) -> bool:
        """Whether `shape_effect` represents it: on one leg, in a model, not by order of reading."""
        return self.in_model and self.leg >= 0 and (self.against != "time" or self.timed)

    @property
    def moves_bar_ends(self) -> bool:
        """Whether the bars of its leg move with it, as a dial on them shows: a displacement of the
        leg's end on the platform is modelled as the opposite displacement of the carriage.
        """
        return self.part == "platform"

    @property
    def depends_on_approach(self) -> bool:
        """Whether it depends on the direction of approach; then no zero absorbs its level."""
        return self.against in ("approach", "reversal")

    def interval(self, stroke: Range) -> Range:
        """First and last value of its variable on a machine with this stroke, metres."""
        return (0.0, stroke[1] - stroke[0]) if self.against == "reversal" else self.span or stroke

    @property
    def has_level(self) -> bool:
        """Whether its mean can be told from the zeros; a change with time begins at zero."""
        return self.depends_on_approach or self.is_local or self.against == "time"

    @property
    def is_signed(self) -> bool:
        """Whether its size has a sign, as its function has one shape or begins at zero."""
        return self.is_local or self.is_line or self.against == "time"

    @property
    def spot(self) -> str:
        """Moment of a jump: ``1710 s``, or ``order 57`` of the last reading before it; or the
        travels between which it is, millimetres, and the way: ``-5 to 20 up``.
        """
        low, high = self.jump or (0.0, 0.0)
        if self.is_step:
            way = ("", " up", " down")[self.side]
            return f"{round(low * 1e3, 1):g} to {round(high * 1e3, 1):g}{way}"
        middle = (low + high) / 2
        return f"{middle:.0f} s" if self.timed else f"order {math.floor(middle)}"

    @property
    def travels_of_step(self) -> list[str]:
        """The travels between which it steps, in millimetres."""
        return [compact(round(travel * 1e3, 1), 4) for travel in self.jump or ()]
