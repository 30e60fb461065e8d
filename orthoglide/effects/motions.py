"""How a parameter moves a virtual joint: bases, conditions and motions of a leg."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from orthoglide.arguments import public

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
    # lost motion that builds up over several lengths after a reversal of the drive, each half the
    # approach after a long distance; empty where the path is unknown
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
