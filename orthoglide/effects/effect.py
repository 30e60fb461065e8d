"""An effect: a physical cause with all that is declared about it.

``displacement of a virtual joint = basis(conditions) x parameter``

A basis is a plain function of a :class:`LegConditions`; it works on numbers, arrays and CasADi
symbols alike (:func:`sin` and :func:`cos` do too). Effects of the *drive* move the joint ``travel``
and may look at the command; all others may look at the carriage's true travel too, the drive's
errors included. An effect of a dial changes the reading instead, see :class:`DialReading`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from orthoglide.arguments import public
from orthoglide.effects.motions import (
    LATERAL_KEYS,
    NO_MOTIONS,
    Condition,
    DialReading,
    Members,
    Motion,
    conditions_read,
)
from orthoglide.effects.words import Words
from orthoglide.errors import InputError
from orthoglide.layout import LegNames, Orthoglide
from orthoglide.parameters import Parameter
from orthoglide.units import Unit, to_si

Group = Literal["structure", "drive", "temperature", "load", "dial", "plate", "part"]
Shape = Callable[[Any, Any], Any]
"""Height of a plate at (x, y), both over the largest measured radius, for one unit."""

ControllerEntry = Literal["zero", "scale", "backlash", "bar_length", "place"]
DRIVE_ENTRIES: tuple[ControllerEntry, ...] = ("zero", "scale", "backlash", "bar_length")
"""Numbers that a controller of three drives has; only firmware has the places of towers."""


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
        instead_of: a condition that explains it better: the effect is a candidate only where
            that condition was not recorded.
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
        """Whether it belongs to a dial, a plate or a part and not to the machine."""
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
        """Its parameters; those of a dial for each of the setups."""
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
