"""What an effect is: a physical cause that moves virtual joints, linear in its parameters.

``displacement of a virtual joint = basis(conditions) x parameter``

A basis is a plain function of a :class:`LegConditions`; it works on numbers, arrays and CasADi
symbols alike. Effects of the *drive* move the joint ``travel`` and may look at the command; all
others may look at the carriage's true travel too, the drive's errors included.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from orthoglide.geometry import LEGS, Leg, axis_index, leg_axes
from orthoglide.units import Unit


@dataclass(frozen=True)
class LegConditions:
    """What one leg saw when a reading was taken.

    Attributes:
        command: rho of the leg's own drive, metres (2008, eq. 2).
        length: nominal bar length L, metres.
        stroke: travel limits from mechanical zero, metres.
        pitch: of the drive's screw, metres; ``None`` where unknown.
        approach: direction of the drive's last move, +1 or -1; 0 where unknown.
        time: seconds since the campaign began.
        warming: kelvin above the campaign's first row.
        force: on the carriage along its own axis under the load, newtons.
        travel: the carriage's true travel from mechanical zero, metres.
    """

    command: Any
    length: float
    stroke: tuple[float, float]
    pitch: float | None
    approach: Any
    time: Any
    warming: Any
    force: Any
    travel: Any = None

    @property
    def nominal_travel(self) -> Any:
        """Commanded travel from mechanical zero, metres."""
        return self.command - self.length

    @property
    def u(self) -> Any:
        """True travel over the stroke: -1 at its lower end, +1 at its upper."""
        low, high = self.stroke
        return (self.travel - (low + high) / 2) / ((high - low) / 2)


Basis = Callable[[LegConditions], Any]


@dataclass(frozen=True)
class Motion:
    """One virtual joint moved by one parameter.

    Attributes:
        joint: the joint's name within its leg, as in ``mechanism.tree.VIRTUAL_NAMES``.
        basis: metres or radians of the joint per unit of the parameter.
    """

    joint: str
    basis: Basis


@dataclass(frozen=True)
class Family:
    """A physical cause with its parameters, one entry of the catalogue.

    Attributes:
        name: as in the names of its parameters.
        unit: of its parameters in files, with its worth in SI.
        tolerance: standard deviation to expect of a carefully built machine, in ``unit``.
        because: why the tolerance has that size.
        sentence: what it is, for a mechanic.
        look_at: what to look at on the machine.
        members: from what stands behind the leg in a parameter's name (``""`` where nothing does)
            to a function that takes the leg and gives the motions.
        group: ``structure``, ``drive``, ``temperature``, ``load`` or ``dial``.
    """

    name: str
    unit: Unit
    tolerance: float
    because: str
    sentence: str
    look_at: str
    members: Callable[[int], Mapping[str, tuple[Motion, ...]]]
    group: str = "structure"

    def parameters(self) -> dict[str, tuple[int, tuple[Motion, ...]]]:
        """All parameters of the family: from name to leg (0, 1, 2) and motions."""
        found: dict[str, tuple[int, tuple[Motion, ...]]] = {}
        for leg, letter in enumerate(LEGS):
            for suffix, motions in self.members(leg).items():
                name = f"{self.name}.{letter}.{suffix}" if suffix else f"{self.name}.{letter}"
                found[name] = (leg, motions)
        return found


def once(*motions: Motion) -> Callable[[int], Mapping[str, tuple[Motion, ...]]]:
    """Members of a family that has one parameter a leg."""
    return lambda leg: {"": motions}


def sideways(
    make: Callable[[str, int], tuple[Motion, ...]],
) -> Callable[[int], Mapping[str, tuple[Motion, ...]]]:
    """Members of a family that has one parameter for each axis j other than the leg's own.

    Args:
        make: takes the leg's name for axis j, ``"b"`` or ``"c"``, and the sign of the turn about
            the other that tips a toward j (a x b = c, a x c = -b).
    """

    def members(leg: int) -> Mapping[str, tuple[Motion, ...]]:
        _, b, c = leg_axes(leg)
        return {LEGS[b]: make("b", +1), LEGS[c]: make("c", -1)}

    return members


def relabelled(name: str) -> str:
    """The parameter's name after the axes are relabelled x -> y -> z -> x."""
    parts = name.split(".")
    turned: list[str] = [parts[0]]
    for part in parts[1:]:
        turned.append(_next(part) if part in LEGS else part)
    return ".".join(turned)


def _next(leg: Leg) -> Leg:
    return LEGS[(axis_index(leg) + 1) % 3]
