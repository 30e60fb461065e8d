"""Readings of all kinds in memory: one table, with the conditions they were taken under.

Arrays hold one entry a reading. Nothing here reads files; units are SI throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.errors import InputError
from orthoglide.frames import html_table
from orthoglide.geometry import LEGS, Array
from orthoglide.instruments import Observation, Setup
from orthoglide.layout import ORTHOGLIDE, LegNames
from orthoglide.observations.approach import (
    Ints,
    Moves,
    built_up_lost_motion,
    derive_approach,
    planned_moves,
)
from orthoglide.observations.arrays import (
    READING_ARRAYS,
    freeze_arrays,
    group_ids,
    source as source,
)


@dataclass(frozen=True)
class Points:
    """Positions of the tool, each measured in one, two or three coordinates."""

    command: Array  # commanded joint coordinates (m, 3), metres
    p: Array  # measured (m, 3), metres; nan where a coordinate is missing
    sigma: Array  # declared standard deviation of a coordinate (m,), metres, nan where none is
    approach: Array  # direction of each axis' last move (m, 3)
    line: Ints  # line in the file (m,)


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of one file or several, of any kinds, with a setup each.

    Only name, setups, commands and readings must be given; the rest has the defaults of an empty
    cell.

    Attributes:
        name: file stem; parameters specific to a campaign carry it.
        setups: the mountings, in order of appearance.
        setup: index into ``setups``, shape ``(n,)``.
        command: commanded joint coordinates ``(n, 3)``, metres, r removed.
        reading: ``(n,)``, metres, of an inclination radians; nan in a sheet not yet filled in.
        approach: direction of each axis' last move ``(n, 3)``: +1, -1, or 0 where unknown.
        time: seconds since the start ``(n,)``, nan where not recorded.
        temperature: degrees Celsius ``(n,)``, nan where not recorded.
        load: weight at the TCP along base -z ``(n,)``, newtons.
        repeat: number of the repetition ``(n,)``, from 1.
        order: place in the sequence the machine went through ``(n,)``; that of the rows if absent.
        posture: labels for people, never used in a computation.
        sigma: declared standard deviation of each reading ``(n,)``, nan where none is.
        line: line in the file ``(n,)``, header line 1.
        axis: base axis that is read ``(n,)``, 0 where there is none; that of the setup where it
            has one.
        sign: +1, or -1 where the instrument counts against it ``(n,)``; that of the setup where
            it has an axis.
        second: the other command of a distance ``(n, 3)``, metres; nan for other kinds.
        file: the file's name as the caller gave it, or ``""``.
        sha256: digest of the file, or ``""``.
        warnings: what was noticed on reading and is no error.
        reference_temperature: what `temperature_rise` counts from; nan: the first one recorded.
        legs: how the machine's legs and commands are called.
        moves: commands gone through between the readings.
        by_point: whether its file has a row for each point of the tool, not for each reading.
        from_frame: readings from a data frame with the columns of their file.
        from_points: measured positions of the tool as readings.
        concatenated: one table of several, whose sequences follow each other.
        to_frame: the rows of the file as a data frame, in the coordinates of a machine's controller
            where that is given.
    """

    from_frame: ClassVar[Callable[..., Readings]]
    from_points: ClassVar[Callable[..., Readings]]
    concatenated: ClassVar[Callable[..., Readings]]
    to_frame: ClassVar[Callable[..., Any]]

    name: str
    setups: tuple[Setup, ...]
    setup: Ints
    command: Array
    reading: Array
    approach: Array = None  # type: ignore[assignment]
    time: Array = None  # type: ignore[assignment]
    temperature: Array = None  # type: ignore[assignment]
    load: Array = None  # type: ignore[assignment]
    repeat: Ints = None  # type: ignore[assignment]
    order: Ints = None  # type: ignore[assignment]
    posture: tuple[str, ...] = None  # type: ignore[assignment]
    sigma: Array = None  # type: ignore[assignment]
    line: Ints = None  # type: ignore[assignment]
    axis: Ints = None  # type: ignore[assignment]
    sign: Array = None  # type: ignore[assignment]
    second: Array = None  # type: ignore[assignment]
    file: str = ""
    sha256: str = ""
    warnings: tuple[Any, ...] = ()
    reference_temperature: float = float("nan")
    legs: LegNames = ORTHOGLIDE.names
    moves: Moves = field(default_factory=Moves)
    by_point: bool = False

    def __post_init__(self) -> None:
        names = [s.name for s in self.setups]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    f"{self.name}: two setups are called {name!r}: give each mounting its own name"
                )
        n, setup = len(np.asarray(self.reading)), np.asarray(self.setup, dtype=float)
        if n and setup.shape == (n,) and not ((setup > -1) & (setup < len(names))).all():
            raise InputError(f"{self.name}: setup must index one of the {len(names)} setups")
        self._fill(n, setup)
        freeze_arrays(self, self.name, READING_ARRAYS, "reading")
        if len(self.posture) != n:
            raise InputError(f"{self.name}: {n} readings need {n} posture labels")

    def _fill(self, n: int, setup: Array) -> None:
        """Take axes and signs from setups that have them, and defaults of what is not given."""
        found: dict[str, Any] = {"order": np.arange(n), "posture": ("",) * n}
        found["line"] = np.arange(n) + 2
        found |= {
            name: kind.default_array(n)
            for name, kind in READING_ARRAYS.items()
            if name not in found
        }
        for name, values in found.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, values)
        for name in ("axis", "sign"):
            values = np.array(getattr(self, name), dtype=float)
            if n and values.shape == setup.shape == (n,):
                fixed = np.array([s.axis >= 0 for s in self.setups])[setup.astype(int)]
                of_setup = np.array([float(getattr(s, name)) for s in self.setups])
                values = np.where(fixed, of_setup[setup.astype(int)], values)
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.reading)

    def __repr__(self) -> str:
        missing = int(np.isnan(self.reading).sum())
        left = f", {missing} of them to be taken" if missing else ""
        kinds = ", ".join(dict.fromkeys(s.kind for s in self.setups if s.kind != "leg"))
        what = f" ({kinds})" if kinds else ""
        setups = "1 setup" if len(self.setups) == 1 else f"{len(self.setups)} setups"
        size = f"{len(self)} readings in {setups}"
        return f"<Readings {self.name!r}: {size}{what}{left}>"

    def _repr_html_(self) -> str:
        columns = {
            "kind": self.kind,
            "setup": [self.setups[k].name for k in self.setup],
            "direction": list(self.direction),
            "posture": self.posture,
            "reading, mm or mrad": (self.reading * 1e3).tolist(),
        }
        return html_table(repr(self)[1:-1], columns)

    # What each reading is -----------------------------------------------------------------

    @property
    def kind(self) -> tuple[str, ...]:
        """Kind of each reading."""
        return tuple(self.setups[k].kind for k in self.setup)

    @property
    def observations(self) -> Iterator[tuple[Observation, NDArray[np.intp]]]:
        """Kinds of readings that there are, each with its rows ``(m,)``."""
        of = [s.observation for s in self.setups]
        for one in dict.fromkeys(of[k] for k in np.unique(self.setup)):
            yield one, np.flatnonzero(np.array([other is one for other in of])[self.setup])

    def which(self, test: Callable[[Setup], Any]) -> NDArray[np.bool_]:
        """Return which readings have a setup that passes a test ``(n,)``, booleans."""
        return np.array([bool(test(s)) for s in self.setups], dtype=bool)[self.setup]

    def of_kind(self, kind: str) -> NDArray[np.bool_]:
        """Return which readings are of a kind ``(n,)``, booleans."""
        return self.which(lambda s: s.kind == kind)

    @property
    def on_legs(self) -> NDArray[np.bool_]:
        """Which readings are of a leg ``(n,)``, booleans; others are of the tool."""
        return self.which(lambda s: s.observation.on_leg)

    @property
    def of_tool(self) -> bool:
        """Whether no reading is of a leg."""
        return not self.on_legs.any()

    @property
    def angular(self) -> NDArray[np.bool_]:
        """Which readings are turns, in radians ``(n,)``, booleans; others are lengths."""
        return self.which(lambda s: s.observation.angular)

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Which readings are touches of a plate ``(n,)``, booleans."""
        return self.which(lambda s: s.observation.touches)

    @property
    def paired(self) -> NDArray[np.bool_]:
        """Which readings have a second command ``(n,)``, booleans."""
        return self.which(lambda s: s.observation.paired)

    @property
    def about_ball(self) -> NDArray[np.bool_]:
        """Which readings are about a fixed ball ``(n,)``, booleans."""
        return self.which(lambda s: s.observation.about_ball)

    @property
    def leg(self) -> Ints:
        """Leg that is read ``(n,)``; -1 where the tool is."""
        return np.array([s.leg for s in self.setups], dtype=np.int64)[self.setup]

    @property
    def gauge(self) -> Array:
        """Where the dial stands along its leg's axis ``(n,)``, metres, r removed."""
        return np.array([s.gauge for s in self.setups])[self.setup]

    @property
    def beside(self) -> Array:
        """Where each reading is taken, from the tool's point on the platform ``(n, 3)``, metres."""
        return np.array([s.beside for s in self.setups]).reshape(-1, 3)[self.setup]

    @property
    def turned_by(self) -> Array:
        """How far the plate of each reading was turned on its seat ``(n,)``, degrees."""
        return np.array([s.turned for s in self.setups])[self.setup]

    @property
    def direction(self) -> tuple[str, ...]:
        """Axis that is read, with its sign as files write it; empty where a kind has none."""
        directed = self.which(lambda s: s.observation.axes)
        each = zip(directed, self.axis, self.sign, strict=True)
        return tuple((("-" if sign < 0 else "") + LEGS[k]) * bool(own) for own, k, sign in each)

    # Conditions ---------------------------------------------------------------------------

    @property
    def temperature_rise(self) -> Array:
        """Temperature less the reference, or the first one recorded ``(n,)``, kelvin; else 0."""
        return np.nan_to_num(self.temperature - self._reference())

    def _reference(self) -> float:
        recorded = self.temperature[np.isfinite(self.temperature)]
        if np.isfinite(self.reference_temperature) or not len(recorded):
            return self.reference_temperature
        return float(recorded[0])

    @property
    def places(self) -> Array:
        """Place of each reading: setup, axis and both commands ``(n, 8)``."""
        second = np.nan_to_num(self.second)
        return np.column_stack([self.setup, self.axis, self.command, second])

    @property
    def stations(self) -> Array:
        """Station of each reading: place, approach of all axes, load ``(n, k)``."""
        return np.column_stack([self.places, self.approach, self.load])

    @cached_property
    def derived_approach(self) -> Array:
        """Approach as the order of readings and moves gives it ``(n, 3)``."""
        return derive_approach(self.command, self.order, self.moves)

    def built_up(self, lengths: Sequence[float]) -> Array:
        """Lost motion of each drive that builds up over some lengths, metres: ``(K, n, 3)``."""
        asked = tuple(lengths)
        if asked not in self._built_up:  # row by row in Python: half a second for 100 000 readings
            self._built_up[asked] = built_up_lost_motion(
                self.command, self.order, asked, self.moves
            )
        return self._built_up[asked]

    @cached_property
    def _built_up(self) -> dict[tuple[float, ...], Array]:
        """What was asked of :meth:`built_up_lost_motion` so far."""
        return {}

    # Other tables -------------------------------------------------------------------------

    def subset(self, rows: ArrayLike) -> Readings:
        """Return some of the readings, with the setups they need.

        Temperatures still count from the first row of this table.

        Args:
            rows: booleans ``(n,)`` or indices.
        """
        kind = bool if np.asarray(rows).dtype == bool else np.int64  # an empty list is of floats
        chosen = np.arange(len(self))[np.asarray(rows, dtype=kind)]
        used, setup = np.unique(self.setup[chosen], return_inverse=True)
        arrays = {name: getattr(self, name)[chosen] for name in READING_ARRAYS}
        return replace(
            self,
            **(arrays | {"setup": setup.reshape(-1)}),
            setups=tuple(self.setups[k] for k in used),
            posture=tuple(self.posture[k] for k in chosen),
            reference_temperature=self._reference(),
        )

    def with_readings(self, reading: ArrayLike) -> Readings:
        """Return the same table with other values ``(n,)``, metres or radians."""
        return replace(self, reading=np.asarray(reading, dtype=float))

    def points(self) -> Points:
        """Return the coordinates of the tool among the readings, point by point.

        Raises:
            InputError: where there are readings of another kind.
        """
        other = ~self.which(lambda s: s.observation.axes and not s.observation.on_leg)
        if (other | self.angular).any():
            raise InputError(f"{self.name} holds readings that are no coordinates of the tool")
        of = group_ids(np.column_stack([self.setup, self.order]))
        first = np.unique(of, return_index=True)[1]
        p = np.full((len(first), 3), np.nan)
        p[of, self.axis] = self.sign * self.reading
        return Points(
            self.command[first], p, self.sigma[first], self.approach[first], self.line[first]
        )

    def with_moves(self) -> Readings:
        """Return the same readings in the order of their rows, with the moves that their approach
        takes.

        Two dials that are read at one visit were mounted together.
        """
        begins = np.zeros(len(self), dtype=bool)
        begins[np.unique(self.setup, return_index=True)[1]] = True
        begins[1:] &= (np.diff(self.command, axis=0) != 0).any(axis=1)
        moves, order = planned_moves(self.command, self.approach, begins, self.moves.overshoot)
        return replace(self, moves=moves, order=order, line=order + 2)

    def in_order(self) -> Readings:
        """Return the same rows gone through one after the other: their order from 1, the sides that
        they are come to from, and the moves that this takes.

        Places are come to as the row before leads to them: the first of each setup from below on
        every axis, one that was visited before from the same side again, as only such visits show
        what the instrument scatters by. A plate is touched from above, whatever came before. Which
        end of a distance the machine goes to first is not known, and no more is its side.
        """
        count, begins = len(self), np.zeros(len(self), dtype=bool)
        begins[np.unique(self.setup, return_index=True)[1]] = True
        approach = derive_approach(self.command, np.arange(count))
        approach[begins] = 1.0
        _, first, visit = np.unique(
            np.column_stack([self.setup, self.command]),
            axis=0, return_index=True, return_inverse=True,
        )  # fmt: skip
        known = ~(self.touching | self.paired)
        approach = approach[first[visit.reshape(-1)]] * known[:, None]
        moves, order = planned_moves(self.command, approach, begins & known, self.moves.overshoot)
        approach[self.touching] = -1.0
        return replace(
            self, order=order + 1, approach=approach, moves=replace(moves, order=moves.order + 1),
            line=order + 2,
        )  # fmt: skip

    def same_as(self, other: Readings) -> bool:
        """Return whether names, setups, labels, moves and all arrays but the lines are equal."""
        return (
            (self.name, self.setups, self.posture) == (other.name, other.setups, other.posture)
            and np.array_equal(self.moves.command, other.moves.command)
            and np.array_equal(self.moves.order, other.moves.order)
            and all(
                np.array_equal(getattr(self, name), getattr(other, name), equal_nan=True)
                for name in READING_ARRAYS
                if name != "line"
            )
        )
