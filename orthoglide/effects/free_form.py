"""Free-form errors: parts of the machine that move in a way that no effect describes.

A free-form error is a free function that moves virtual joints of one leg. Its level and slope are
kept, so the effects of the catalogue compete with them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any, Literal

import numpy as np

from orthoglide.effects import free_form_words, kernels
from orthoglide.effects.effect import Effect
from orthoglide.effects.kernels import BuildUp, Bump, Kernel, Level, Step
from orthoglide.effects.motions import LegConditions, Members, Motion
from orthoglide.geometry import LEGS, Array
from orthoglide.layout import LegNames, Orthoglide
from orthoglide.numerals import compact
from orthoglide.units import MM, RAD

Dependence = Literal["travel", "approach", "reversal", "command", "time", "reading"]
Part = Literal["drive", "screw", "rail", "carriage", "bar", "platform", "dial"]
Range = tuple[float, float]
FreeFunctions = Kernel | BuildUp | Bump | Step | Level
_UM = 1e-6


@dataclass(frozen=True)
class FreeForm:
    """A part of the machine, and the free function by which it moves."""

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
        return self.location_key.replace("/travel", "/waves" if self.short_waves else "/travel")

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
        return self.jump is not None or self.wide > 0 or self.is_line

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

    @cached_property
    def sampled(self) -> tuple[Array, Array]:
        """Values of its variable, from -1 to 1 over its interval ``(n,)``, and its functions there
        for coefficients of unit variance ``(n, k)``, without a mean that zeros absorb.
        """
        u = kernels.sample_points(self.kernel, self.short_waves)
        functions = np.stack(self.kernel.functions(u), axis=1)
        return u, functions if self.has_level else functions - functions.mean(axis=0)

    def size(self, value: Array) -> float:
        """Return the size of its values at `sampled` ``(n,)``: the largest of a bump, jump or
        change with time, with its sign; the range after a reversal, the root mean square difference
        of both approaches, and else the root mean square about the mean, of a line with its sign.
        """
        if self.is_local or self.against == "time":
            return float(value[np.abs(value).argmax()])
        if self.against == "approach":
            return float(np.sqrt(np.mean(value**2)))
        slope = np.sign(value[-1] - value[0]) if self.is_line else 1.0
        return float(np.ptp(value) if self.against == "reversal" else slope * np.std(value))

    def size_of(self, values: Mapping[str, float]) -> float:
        """Return its size by the values of its effect's parameters, SI, by their numbers."""
        if "" in values:  # of `shape_effect`, whose parameter is its size
            return values[""]
        _, functions = self.sampled
        mean = [values.get(str(k + 1), 0.0) for k in range(functions.shape[1])]
        return self.size(functions @ mean)

    @cached_property
    def effect(self) -> Effect:
        """The effect with one parameter a coefficient, for a machine that has this error."""
        kernel = self.kernel.lasting if isinstance(self.kernel, Step) else self.kernel
        lasting = replace(self, kernel=kernel)
        return lasting._effect(partial(_members, lasting))

    def shape_effect(self, coefficients: Array) -> Effect:
        """Return the effect of the error with the shape that it was found with: its one parameter
        is its size. A jump in time recurs in every campaign.

        ``coefficients``: its mean ``(k,)``, in their prior standard deviations.
        """
        size = self.size(self.sampled[1] @ coefficients)
        return self._effect(partial(_shape_members, self, tuple(coefficients / size)))

    def _effect(self, members: Members) -> Effect:
        unit = RAD if self.is_rotation else MM
        name = re.sub(r"\W", "_", self.name)  # a setup may be called anything
        because = "what no known shape explains is a few hundredths"
        return Effect(
            name, unit, self.prior_sd / unit.si, because, self.words, self.look_at, members,
            free_form_words.effect_words(self), paired=True, names=self.names, size_of=self.size_of,
        )  # fmt: skip

    @property
    def words(self) -> str:
        """Clause with the location and the kind of the error, without its size."""
        return free_form_words.clause(self)

    @property
    def look_at(self) -> str:
        """What to look at on the machine."""
        return free_form_words.look_at(self)

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

    def functions(self, conditions: LegConditions, which: slice = slice(None)) -> list[Any]:
        """The free functions at these conditions, for coefficients of unit variance."""
        if self.against == "reversal":
            return list(conditions.built_up[which])
        values = self.kernel.functions(self._variable(conditions), which)
        if self.against == "approach":
            share = (abs(self.side) + (self.side or 1) * conditions.approach) / 2
            return [value * share for value in values]
        if self.part == "screw":
            half = (conditions.stroke[1] - conditions.stroke[0]) / 2
            return [value * (conditions.nominal_travel / half) for value in values]
        return values

    def _variable(self, c: LegConditions) -> Any:
        """Return what it depends on, from -1 to 1 over the stroke or the session.

        It is the carriage's travel or, of a drive, a command; a time is constant outside of the
        session.
        """
        if self.against == "time":
            start, end = self.span or (0.0, 1.0)
            position = (c.time - start) / max((end - start) / 2, 1e-9) - 1
            return (abs(position + 1) - abs(position - 1)) / 2  # of symbols too
        if self.part != "drive":
            return c.u
        drive = self.command_drive if self.against == "command" else self.leg
        return c.over_stroke(c.commands[drive] - c.command + c.nominal_travel)


def _members(form: FreeForm, leg: int) -> Mapping[str, tuple[Motion, ...]]:
    """Return the members of the effect of a free-form error: one parameter a coefficient."""
    return {
        str(k + 1): tuple(Motion(j, partial(_basis, form, k, share)) for j, share in form.joints)
        for k in range(form.kernel.count if leg == form.leg else 0)
    }


def _shape_members(
    form: FreeForm, shape: tuple[float, ...], leg: int
) -> Mapping[str, tuple[Motion, ...]]:
    """Return the member of the effect of a free-form error of one shape."""
    if leg != form.leg:
        return {}
    return {"": tuple(Motion(j, partial(_shape, form, shape, share)) for j, share in form.joints)}


def _shape(
    form: FreeForm, shape: tuple[float, ...], share: float, conditions: LegConditions
) -> Any:
    functions = form.functions(conditions)
    return share * sum(weight * f for weight, f in zip(shape, functions, strict=True))


def _basis(form: FreeForm, k: int, share: float, conditions: LegConditions) -> Any:
    return share * form.functions(conditions, slice(k, k + 1))[0]


_SCREW_GROWTH = 10 * _UM  # half a stroke of steel, 80 mm, that warms by ten kelvin
# Linear warming of a drive is as frequent as that of bars, which is a cause of the catalogue: ten
# times as frequent as a free-form error.
_WARMTH_CHANCE = 10.0


@dataclass(frozen=True)
class Session:
    """The time interval of a measurement."""

    start: float  # first moment
    end: float  # last moment
    timed: bool = True  # whether moments are seconds; else they count the readings


def free_forms(
    session: Session | None = None,
    names: LegNames = Orthoglide.names,
    stroke: Range = (-kernels.LENGTH, kernels.LENGTH),
    scale: float = 1.0,
) -> tuple[FreeForm, ...]:
    """Return all free-form errors of a machine.

    Args:
        session: of the campaign; without one, nothing changes with time.
        names: of legs and directions.
        stroke: travel limits of the machine, metres.
        scale: of its size, that of a workshop being 1.
    """
    half = (stroke[1] - stroke[0]) / 2
    forms: list[FreeForm] = []
    for leg in range(len(LEGS)):
        for form in _leg_forms(leg):
            forms.append(form)
            if form.against == "travel" and form.part == "drive":
                forms.append(replace(form, kernel=kernels.SCREW, short_waves=True))
            elif form.against == "travel" and form.part != "platform" and half > kernels.SHORT_FROM:
                forms.append(
                    replace(form, kernel=kernels.short_wave_kernel(half), short_waves=True)
                )
    if session is not None:
        forms += _time_dependent_forms(session)
    return tuple(scaled_to_machine(replace(form, names=names), scale) for form in forms)


def _leg_forms(leg: int) -> Iterator[FreeForm]:
    """Yield the free-form errors of one leg that do not depend on time, without short waves."""
    yield FreeForm("drive", leg, "", "travel", kernels.DRIVE, 100 * _UM)
    yield FreeForm("drive", leg, "", "approach", kernels.LOST)
    yield FreeForm("drive", leg, "", "reversal", kernels.BUILD_UP)
    for other, kernel in product(range(len(LEGS)), (kernels.ACROSS, kernels.LINE)):
        if other != leg:
            yield FreeForm("drive", leg, "", "command", kernel, command_drive=other)
    # A straight line of the rail is a tilt of its axis, which has a name.
    kernels_of: dict[Part, Kernel] = {"rail": kernels.FINE, "platform": kernels.FINE_AND_LINE}
    for axis in "bc":
        for part, kernel in kernels_of.items():
            yield FreeForm(part, leg, axis, "travel", kernel)
            yield FreeForm(part, leg, axis, "approach", kernels.COARSE)
    for axis in "abc":
        yield FreeForm("carriage", leg, axis, "travel", kernels.ACROSS, 1e-3)
    for bar in "12":
        yield FreeForm("bar", leg, bar, "approach", kernels.COARSE)


def _time_dependent_forms(session: Session) -> Iterator[FreeForm]:
    """Yield what changes in a session: one bar or both of a leg, one drive or all alike."""
    span = session.start, session.end
    form = partial(FreeForm, against="time", span=span, timed=session.timed)
    for leg in range(len(LEGS)):
        for bars in ("1", "2", ""):
            yield form("bar", leg, bars, kernel=kernels.DRIFT)
    for leg in (-1, *range(len(LEGS))):  # -1: all drives alike
        drift = form("drive", leg, "", kernel=kernels.DRIFT, prior_sd=100 * _UM)
        for warm in (drift, replace(drift, part="screw", prior_sd=_SCREW_GROWTH)):
            yield warm
            yield replace(warm, kernel=kernels.STEADY, chance=_WARMTH_CHANCE)


def scaled_to_machine(form: FreeForm, scale: float) -> FreeForm:
    """Return a free-form error with its prior scaled to a machine's size; angles do not scale."""
    return form if form.is_rotation else replace(form, prior_sd=form.prior_sd * scale)
