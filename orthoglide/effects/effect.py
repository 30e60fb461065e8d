"""An effect: a physical cause with all that is declared about it.

``displacement of a virtual joint = basis(conditions) x parameter``

A basis is a plain function of a :class:`LegConditions`; it works on numbers, arrays and CasADi
symbols alike (:func:`sin` and :func:`cos` do too). Effects of the *drive* move the joint ``travel``
and may look at the command; all others may look at the carriage's true travel too, the drive's
errors included. An effect of an instrument (dial, plate, printed part) moves no joint and changes
the reading.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from orthoglide.arguments import public
from orthoglide.effects.words import Words
from orthoglide.errors import InputError
from orthoglide.layout import LegNames, Orthoglide
from orthoglide.parameters import Parameter
from orthoglide.units import Unit, to_si

Condition = Literal["approach", "time", "temperature", "load", "pitch"]
LATERAL_KEYS = ("@b", "@c")  # stand for the names that a layout gives a leg's axes b and c


@dataclass(frozen=True)
class LegConditions:
    """The conditions of one leg when a reading was taken."""

    command: Any  # of the leg's own drive, metres; on the Orthoglide rho (2008, eq. 2).
    length: float  # nominal bar length L, metres
    stroke: tuple[float, float]  # travel limits from mechanical zero, metres
    pitch: float | None  # of the drive's screw, metres; `None` where unknown
    approach: Any  # direction of the drive's last move, +1 or -1; 0 where unknown
    time: Any  # seconds since the campaign began
    warming: Any  # kelvin above the campaign's first row
    force: Any  # on the carriage along its own axis under the load, newtons
    travel: Any = None  # the carriage's true travel from mechanical zero, metres
    zero: float = 0.0  # the command at mechanical zero, metres
    commands: tuple[Any, ...] = ()  # of all drives, metres
    # lost motion as a fraction of the backlash, one entry for each characteristic length (Dahl
    # model): it approaches half of `approach` exponentially after a reversal. It is computed for
    # dials on the legs only, and empty otherwise
    built_up: tuple[Any, ...] = ()

    @property
    def nominal_travel(self) -> Any:
        """Commanded travel from mechanical zero, metres."""
        return self.command - self.zero

    @property
    def u(self) -> Any:
        """True travel over the stroke: -1 at its lower end, +1 at its upper."""
        return self.over_stroke(self.travel)

    def over_stroke(self, travel: Any) -> Any:
        """Return a travel over the stroke: -1 at its lower end, +1 at its upper."""
        low, high = self.stroke
        return (travel - (low + high) / 2) / ((high - low) / 2)


@dataclass(frozen=True)
class DialReading:
    """An intermediate value between the touched line and the displayed reading."""

    shown: Any  # the reading so far, metres
    across: Any  # the coordinate toward which the dial turns about the leg, with the dial's sign
    time: Any  # seconds since the campaign began


Basis = Callable[[LegConditions], Any]


@dataclass(frozen=True)
class Constant:
    """A basis that does not depend on conditions."""

    value: float

    def __call__(self, conditions: LegConditions) -> float:
        """The value."""
        return self.value


_CONDITIONS: Mapping[str, Condition] = {
    "approach": "approach", "time": "time", "warming": "temperature", "force": "load",
    "pitch": "pitch",
}  # fmt: skip


class _Recorder:
    """Passes on the attributes of a sample, and records which conditions are read."""

    def __init__(self, sample: LegConditions | DialReading) -> None:
        self.sample, self.read = sample, set[Condition]()

    def __getattr__(self, name: str) -> Any:
        if name in _CONDITIONS:
            self.read.add(_CONDITIONS[name])
        return getattr(self.sample, name)


def conditions_read(
    function: Callable[[Any], Any], sample: LegConditions | DialReading
) -> frozenset[Condition]:
    """Return the conditions that a function reads, found by evaluating it on a sample."""
    recorder = _Recorder(sample)
    function(recorder)
    return frozenset(recorder.read)


def sin(angle: Any) -> Any:
    """Sine of a number, an array or a CasADi symbol, radians."""
    return angle.sin() if hasattr(angle, "sin") else np.sin(angle)


def cos(angle: Any) -> Any:
    """Cosine of a number, an array or a CasADi symbol, radians."""
    return angle.cos() if hasattr(angle, "cos") else np.cos(angle)


def exp(value: Any) -> Any:
    """Exponential of a number, an array or a CasADi symbol."""
    return value.exp() if hasattr(value, "exp") else np.exp(value)


@public
@dataclass(frozen=True)
class Motion:
    """One virtual joint moved by one parameter.

    Attributes:
        joint: the joint's name within its leg, as in ``mechanism.tree.VIRTUAL_NAMES``.
        basis: metres or radians of the joint per unit of the parameter.
    """

    joint: str
    basis: Basis

    @property
    def needs(self) -> frozenset[Condition]:
        """Conditions that the basis reads, found by evaluating it."""
        sample = 0.3, 0.3, (-0.1, 0.06), 0.02, 1.0, 1.0, 1.0, 1.0, 0.01, 0.3, (0.3,) * 3
        return conditions_read(self.basis, LegConditions(*sample))


Members = Callable[[int], Mapping[str, tuple[Motion, ...]]]


@dataclass(frozen=True)
class _SameForEachLeg:
    """Members that are identical for all legs; they pickle if their bases do."""

    members: tuple[tuple[str, tuple[Motion, ...]], ...]

    def __call__(self, leg: int) -> Mapping[str, tuple[Motion, ...]]:
        return dict(self.members)


NO_MOTIONS = _SameForEachLeg(())
"""Members of an effect that moves no virtual joint."""


@public
def once(*motions: Motion) -> Members:
    """Return the members of an effect that has one parameter a leg.

    Args:
        motions: of the leg's virtual joints, for one unit of the parameter.
    """
    return _SameForEachLeg((("", motions),))


@public
def sideways(make: Callable[[str, int], tuple[Motion, ...]]) -> Members:
    """Return the members of an effect with one parameter for each axis j across the leg.

    Args:
        make: takes the leg's name for axis j, ``"b"`` or ``"c"``, and the sign of the turn about
            the other that tips a toward j (a x b = c, a x c = -b).
    """
    b, c = LATERAL_KEYS
    return _SameForEachLeg(((b, tuple(make("b", +1))), (c, tuple(make("c", -1)))))


Group = Literal["structure", "drive", "temperature", "load", "dial", "plate", "part"]
Shape = Callable[[Any, Any], Any]
"""Height of a plate at (x, y), both over the largest measured radius, for one unit."""

ControllerEntry = Literal["zero", "scale", "backlash", "bar_length", "place"]
DRIVE_ENTRIES: tuple[ControllerEntry, ...] = ("zero", "scale", "backlash", "bar_length")
"""Numbers that a controller of three drives stores. Tower positions are not among them: only
printer firmware stores those."""


@public
@dataclass(frozen=True, repr=False)
class Effect:
    """A physical cause with its parameters, one entry of the catalogue.

    It pickles where its functions do: those of a module, not lambdas.

    Attributes:
        name: as in the names of its parameters.
        unit: of its parameters in files, with its worth in SI.
        tolerance: standard deviation to expect of a carefully built machine, in ``unit``.
        because: why the tolerance has that size.
        sentence: what it is, for a mechanic.
        look_at: what to look at on the machine.
        members: returns the motions of a leg (0, 1, 2) by the suffix that follows the leg in a
            parameter's name, ``""`` for none; see :func:`once` and :func:`sideways`.
        words: sentences for a fitted value, and the test on the machine that confirms it.
        group: ``structure``, ``drive``, ``temperature``, ``load``, ``dial``, ``plate`` or
            ``part``.
        paired: whether the parameters of a leg or setup are one cause, as a sine and its cosine.
        lobes: number of high sides around the plate, of an effect of a plate with a cosine and a
            sine of that many times the angle.
        instead_of: the condition that this effect stands in for: it is a candidate only where that
            condition was not recorded.
        controller: which number of a controller corrects it, if any.
        urdf: whether a rigid URDF can represent it.
        dial: of an effect of the dial: the reading shown, given the reading so far and the value.
        plate: of an effect of a probed plate: its shapes, each with the suffix that follows the
            setup in its parameter's name.
        part: of an effect of a printed part: the length read, given that of the tool and the value.
        per_setup: whether it belongs to the way in which a part was measured, not to the part.
        names: of legs and directions, of the layout that it belongs to.
        points: preposition before the direction of a positive value, such as "toward".
        size_of: of a paired effect: function from its parameters, as direction to value, SI, to its
            size, SI; by default the amplitude.
        shape: of such an effect on a calibrated machine: its parameters for one unit of its size.
    """

    name: str
    unit: Unit
    tolerance: float
    because: str
    sentence: str
    look_at: str
    members: Members = NO_MOTIONS
    words: Words = field(default_factory=Words)
    group: Group = "structure"
    paired: bool = False
    lobes: int = 0
    instead_of: Condition | None = None
    controller: ControllerEntry | None = None
    urdf: bool = False
    dial: Callable[[DialReading, Any], Any] | None = None
    plate: tuple[tuple[str, Shape], ...] = ()
    part: Callable[[Any, Any], Any] | None = None
    per_setup: bool = False
    names: LegNames = Orthoglide.names
    points: str = "toward"
    size_of: Callable[[Mapping[str, float]], float] | None = None
    shape: tuple[tuple[Parameter, float], ...] = ()

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise InputError(f"an effect's name is one word like axis_tilt, not {self.name!r}")
        if not (isinstance(self.unit, Unit) and callable(self.members)):
            raise InputError(f"{self.name}: unit is one like MM, and members are once(...)")
        if not self.tolerance > 0:
            raise InputError(f"{self.name}: the tolerance must be above 0, not {self.tolerance}")

    def __repr__(self) -> str:
        return f"<Effect {self.name}: {self.sentence}>"

    @property
    def of_dial(self) -> bool:
        """Whether it changes the reading of an instrument (dial, plate, printed part) and does not
        move the machine.
        """
        return self.dial is not None or bool(self.plate) or self.part is not None

    @property
    def of_body(self) -> bool:
        """Whether it belongs to a plate or a part, which stays the same in all setups."""
        return bool(self.plate) or (self.part is not None and not self.per_setup)

    @property
    def sided(self) -> bool:
        """Whether its parameters have a direction across their leg."""
        return any(key in LATERAL_KEYS for key in self.members(0))

    @property
    def shapes(self) -> dict[str, Shape]:
        """Shapes of a plate by the suffix of the parameter's name."""
        return dict(self.plate)

    def high_side(self, values: Mapping[str, float]) -> float:
        """Return the direction of a high side of a plate, degrees counter-clockwise from +x.

        Args:
            values: of its shapes ``"cos"`` and ``"sin"``; an absent one is zero.

        Returns:
            The smallest direction that is not negative; nan for an effect without lobes.
        """
        if not self.lobes:
            return math.nan
        phase = math.degrees(math.atan2(values.get("sin", 0.0), values.get("cos", 0.0)))
        return phase / self.lobes % (360 / self.lobes)

    def amplitude(self, values: Mapping[str, float]) -> float:
        """Return the size of a paired effect, SI: by `size_of`, or the root of the sum of squares.

        ``values``: its parameters, SI, by their directions.
        """
        return math.hypot(*values.values()) if self.size_of is None else self.size_of(values)

    @property
    def tolerance_si(self) -> float:
        """Standard deviation to expect, SI."""
        return to_si(self.tolerance, self.unit.si)

    @cached_property
    def motions(self) -> dict[Parameter, tuple[int, tuple[Motion, ...]]]:
        """All parameters of the machine: from name to leg (0, 1, 2) and motions."""
        motions_by_name = {}
        for leg, name in enumerate(self.names.legs):
            directions = dict(zip(LATERAL_KEYS, self.names.across[leg], strict=True))
            for key, motions in self.members(leg).items():
                parameter = Parameter(self.name, name, directions.get(key, key))
                motions_by_name[parameter] = leg, motions
        return motions_by_name

    def parameters(self, setups: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
        """Its parameters; those of an instrument for each of the setups."""
        if self.of_dial:
            return tuple(
                Parameter(self.name, setup=setup, direction=part)
                for setup in setups
                for part in self.shapes or ("",)
            )
        return tuple(self.motions)

    @cached_property
    def needs(self) -> frozenset[Condition]:
        """Conditions that its bases depend on, found by evaluating them."""
        if (dial := self.dial) is not None:
            return conditions_read(lambda reading: dial(reading, 1e-3), DialReading(1.0, 1.0, 1.0))
        needs_by_motion = [m.needs for _, motions in self.motions.values() for m in motions]
        return frozenset().union(*needs_by_motion)

    @property
    def at_rest(self) -> bool:
        """Whether it moves the TCP of a machine without load, at its first temperature and time."""
        return not self.of_dial and not self.needs & {"time", "temperature", "load"}
