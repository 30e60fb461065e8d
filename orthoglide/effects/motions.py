"""How a parameter moves a virtual joint: bases, the conditions they look at, motions of a leg."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

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
    # lost motion that builds up over some lengths after the drive turns round, each half its
    # approach after a long way; none where nobody knows
    built_up: tuple[Any, ...] = ()

    @property
    def nominal_travel(self) -> Any:
        """Commanded travel from mechanical zero, metres."""
        return self.command - self.zero

    @property
    def u(self) -> Any:
        """True travel over the stroke: -1 at its lower end, +1 at its upper."""
        low, high = self.stroke
        return (self.travel - (low + high) / 2) / ((high - low) / 2)


@dataclass(frozen=True)
class DialReading:
    """A reading on its way from the touched line to the number shown."""

    shown: Any  # the reading so far, metres
    across: Any  # the coordinate toward which the dial turns about the leg, with the dial's sign
    time: Any  # seconds since the campaign began


Basis = Callable[[LegConditions], Any]


@dataclass(frozen=True)
class Constant:
    """A basis that is the same under all conditions."""

    value: float

    def __call__(self, conditions: LegConditions) -> float:
        """The value."""
        return self.value


_CONDITIONS: Mapping[str, Condition] = {
    "approach": "approach", "time": "time", "warming": "temperature", "force": "load",
    "pitch": "pitch",
}  # fmt: skip


class _Recorder:
    """Numbers in place of what a basis sees, and a note of which were looked at."""

    def __getattribute__(self, name: str) -> Any:
        if name in _CONDITIONS:
            object.__getattribute__(self, "__dict__").setdefault("used", set()).add(name)
        return object.__getattribute__(self, name)

    def needs(self, look: Callable[[Any], Any]) -> frozenset[Condition]:
        """Conditions that a function looks at, found by evaluating it."""
        self.__dict__["used"] = set()
        look(self)
        return frozenset(_CONDITIONS[name] for name in self.__dict__["used"])


class _LegRecorder(_Recorder, LegConditions):
    pass


class DialRecorder(_Recorder, DialReading):
    """Numbers in place of a dial's reading, and a note of whether its time was looked at."""


def sin(angle: Any) -> Any:
    """Sine of a number, an array or a CasADi symbol, radians."""
    return angle.sin() if hasattr(angle, "sin") else np.sin(angle)


def cos(angle: Any) -> Any:
    """Cosine of a number, an array or a CasADi symbol, radians."""
    return angle.cos() if hasattr(angle, "cos") else np.cos(angle)


def exp(value: Any) -> Any:
    """Exponential of a number, an array or a CasADi symbol."""
    return value.exp() if hasattr(value, "exp") else np.exp(value)


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
        """Conditions that the basis looks at, found by evaluating it."""
        some = 0.3, 0.3, (-0.1, 0.06), 0.02, 1.0, 1.0, 1.0, 1.0, 0.01, 0.3, (0.3,) * 3
        return _LegRecorder(*some).needs(self.basis)


Members = Callable[[int], Mapping[str, tuple[Motion, ...]]]


def no_motions(leg: int) -> Mapping[str, tuple[Motion, ...]]:
    """Members of an effect that moves no virtual joint."""
    return {}


@dataclass(frozen=True)
class _SameForEachLeg:
    """Members that are the same for each leg; they pickle where their bases do."""

    members: tuple[tuple[str, tuple[Motion, ...]], ...]

    def __call__(self, leg: int) -> Mapping[str, tuple[Motion, ...]]:
        return dict(self.members)


def once(*motions: Motion) -> Members:
    """Members of an effect that has one parameter a leg.

    Args:
        motions: of the leg's virtual joints, for one unit of the parameter.
    """
    return _SameForEachLeg((("", motions),))


def sideways(make: Callable[[str, int], tuple[Motion, ...]]) -> Members:
    """Members of an effect that has one parameter for each axis j other than the leg's own.

    Args:
        make: takes the leg's name for axis j, ``"b"`` or ``"c"``, and the sign of the turn about
            the other that tips a toward j (a x b = c, a x c = -b).
    """
    return _SameForEachLeg(
        ((LATERAL_KEYS[0], tuple(make("b", +1))), (LATERAL_KEYS[1], tuple(make("c", -1))))
    )
