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

from orthoglide.arguments import public
from orthoglide.errors import InputError
from orthoglide.frames import html_table
from orthoglide.geometry import LEGS, Array
from orthoglide.instruments import OBSERVATIONS, Observation, Setup
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
    checked_array,
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


@public
@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of one file or several, of any kinds, with a setup each.

    Only name, setups, commands and readings must be given; other defaults are those of an empty
    cell. A single value of an array counts for all readings.

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
        order: position in the machine's sequence ``(n,)``; that of the rows if absent.
        posture: labels for people, never used in a computation.
        sigma: declared standard deviation of each reading ``(n,)``, nan where none is.
        line: line in the file ``(n,)``, header line 1.
        axis: base axis that is read ``(n,)``, 0 where there is none; the setup's if it has one.
        sign: +1, or -1 where the instrument counts against it ``(n,)``; the setup's if it has an
            axis.
        second: the other command of a distance ``(n, 3)``, metres; nan for other kinds.
        file: the file's name as the caller gave it, or ``""``.
        label: what messages call the file if its name without a folder is not enough, or ``""``.
        sha256: digest of the file, or ``""``.
        warnings: remarks on reading that are no errors.
        reference_temperature: zero of `temperature_rise`; nan: the first one recorded.
        legs: names of the machine's legs and commands.
        moves: commands between the readings.
        by_point: whether its file has a row for each point of the tool, not for each reading.
        from_frame: readings from a data frame with the columns of their file.
        from_points: measured positions of the tool as readings.
        concatenated: one table of several, whose sequences follow each other.
        to_frame: the rows of the file as a data frame, with commands as a machine's controller
            shows them if a machine is given.
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
    label: str = ""

    def __post_init__(self) -> None:
        names = [s.name for s in self.setups]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    f"{self.name}: two setups are called {name!r}: give each mounting its own name"
                )
        n = len(np.atleast_1d(self.reading))
        counted = {"order": np.arange(n), "line": np.arange(n) + 2, "posture": ("",) * n}
        for name, values in counted.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, values)
        for name, spec in READING_ARRAYS.items():
            array = checked_array(getattr(self, name), spec, n, f"{self.name}: {name}")
            object.__setattr__(self, name, array)
        if not ((self.setup > -1) & (self.setup < len(names))).all():
            raise InputError(f"{self.name}: setup must index one of the {len(names)} setups")
        if not np.isin(self.approach, (-1.0, 0.0, 1.0)).all():
            raise InputError(
                f"{self.name}: approach is +1 or -1 for each axis, or 0 where it is not known"
            )
        if len(self.posture) != n:
            raise InputError(f"{self.name}: {n} readings need {n} posture labels")
        for name in ("axis", "sign"):  # of setups that have them
            of_setup = [getattr(s, name) if s.axis >= 0 else np.nan for s in self.setups]
            values = np.array(of_setup, dtype=float)[self.setup]
            values = np.where(np.isnan(values), getattr(self, name), values)
            array = checked_array(values, READING_ARRAYS[name], n, f"{self.name}: {name}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.reading)

    def __repr__(self) -> str:
        missing = int(np.isnan(self.reading).sum())
        unread = f", {missing} of them to be taken" if missing else ""
        kinds = ", ".join(dict.fromkeys(s.kind for s in self.setups if s.kind != "leg"))
        kinds = f" ({kinds})" if kinds else ""
        setups = "1 setup" if len(self.setups) == 1 else f"{len(self.setups)} setups"
        return f"<Readings {self.name!r}: {len(self)} readings in {setups}{kinds}{unread}>"

    def _repr_html_(self) -> str:
        columns = {
            "kind": self.kind,
            "setup": [self.setups[k].name for k in self.setup],
            "direction": list(self.direction),
            "posture": self.posture,
            "reading, mm or mrad": (self.reading * 1e3).tolist(),
        }
        return html_table(repr(self)[1:-1], columns)

    # Kinds and setups --------------------------------------------------------------------

    @property
    def kind(self) -> tuple[str, ...]:
        """Kind of each reading."""
        return tuple(self.setups[k].kind for k in self.setup)

    @property
    def observations(self) -> Iterator[tuple[Observation, NDArray[np.intp]]]:
        """Kinds of the readings, each with its rows ``(m,)``."""
        for kind in dict.fromkeys(self.setups[k].kind for k in np.unique(self.setup)):
            yield OBSERVATIONS[kind], np.flatnonzero(self.of_kind(kind))

    def which(self, test: Callable[[Setup], Any]) -> NDArray[np.bool_]:
        """Return the readings whose setup passes a test ``(n,)``, booleans."""
        return np.array([bool(test(s)) for s in self.setups], dtype=bool)[self.setup]

    def of_kind(self, kind: str) -> NDArray[np.bool_]:
        """Return the readings of a kind ``(n,)``, booleans."""
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
        """Which readings are angles, in radians ``(n,)``, booleans; others are lengths."""
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
    def leg(self) -> Ints:
        """Leg that is read ``(n,)``; -1 where the tool is read."""
        return np.array([s.leg for s in self.setups], dtype=np.int64)[self.setup]

    @property
    def gauge(self) -> Array:
        """Place of the dial along its leg's axis ``(n,)``, metres, r removed."""
        return np.array([s.gauge for s in self.setups])[self.setup]

    @property
    def beside(self) -> Array:
        """Offset of each reading from the tool, along the platform's axes ``(n, 3)``, metres."""
        return np.array([s.beside for s in self.setups]).reshape(-1, 3)[self.setup]

    @property
    def turned_by(self) -> Array:
        """Rotation of the plate of each reading on its seat ``(n,)``, degrees."""
        return np.array([s.turned for s in self.setups])[self.setup]

    @property
    def direction(self) -> tuple[str, ...]:
        """Axis that is read, with its sign as in files; empty where a kind has none."""
        directed = self.which(lambda s: s.observation.axes)
        signed_axes = zip(directed, self.axis, self.sign, strict=True)
        return tuple(
            (("-" if sign < 0 else "") + LEGS[k]) * bool(is_directed)
            for is_directed, k, sign in signed_axes
        )

    # Conditions ---------------------------------------------------------------------------

    @property
    def temperature_rise(self) -> Array:
        """Temperature minus the reference, or the first one recorded ``(n,)``, kelvin; else 0."""
        return np.nan_to_num(self.temperature - self._reference())

    def _reference(self) -> float:
        recorded = self.temperature[np.isfinite(self.temperature)]
        if np.isfinite(self.reference_temperature) or not len(recorded):
            return self.reference_temperature
        return float(recorded[0])

    @property
    def places(self) -> Array:
        """Place of each reading: setup, axis with its sign, and both commands ``(n, 9)``."""
        second = np.nan_to_num(self.second)
        return np.column_stack([self.setup, self.axis, self.sign, self.command, second])

    @property
    def stations(self) -> Array:
        """Station of each reading: place, approach of all axes, load ``(n, k)``."""
        return np.column_stack([self.places, self.approach, self.load])

    @cached_property
    def place_number(self) -> Ints:
        """Number of each reading's place ``(n,)``, whatever the approach."""
        return group_ids(self.places)

    @cached_property
    def derived_approach(self) -> Array:
        """Approach that follows from the order of readings and moves ``(n, 3)``."""
        return derive_approach(self.command, self.order, self.moves)

    def built_up(self, lengths: Sequence[float]) -> Array:
        """Return the lost motion of each drive, built up over lengths in metres ``(K, n, 3)``."""
        key = tuple(lengths)
        if key not in self._built_up:  # row by row in Python: half a second for 100 000 readings
            self._built_up[key] = built_up_lost_motion(self.command, self.order, key, self.moves)
        return self._built_up[key]

    @cached_property
    def _built_up(self) -> dict[tuple[float, ...], Array]:
        """Cache of :meth:`built_up`."""
        return {}

    # Other tables -------------------------------------------------------------------------

    def subset(self, rows: ArrayLike) -> Readings:
        """Return some of the readings, with their setups.

        The temperature rise still counts from the first row of this table.

        Args:
            rows: booleans ``(n,)`` or indices.
        """
        kind = bool if np.asarray(rows).dtype == bool else np.int64  # an empty list is of floats
        indices = np.atleast_1d(np.asarray(rows, dtype=kind))
        if indices.ndim > 1 or (kind is bool and len(indices) != len(self)):
            raise InputError(f"{self.name}: rows are indices, or {len(self)} booleans")
        chosen = np.arange(len(self))[indices]
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
        """Return the table with other readings ``(n,)``, metres or radians."""
        return replace(self, reading=np.asarray(reading, dtype=float))

    def points(self) -> Points:
        """Return the coordinates of the tool by point.

        Raises:
            InputError: if there are readings of another kind.
        """
        other = ~self.which(lambda s: s.observation.axes and not s.observation.on_leg)
        if (other | self.angular).any():
            raise InputError(f"{self.name} must hold coordinates of the tool alone")
        point = group_ids(np.column_stack([self.setup, self.order]))
        first = np.unique(point, return_index=True)[1]
        p = np.full((len(first), 3), np.nan)
        p[point, self.axis] = self.sign * self.reading
        return Points(
            self.command[first], p, self.sigma[first], self.approach[first], self.line[first]
        )

    def with_moves(self) -> Readings:
        """Return the readings in the order of their rows, with the moves that their approaches
        require.

        Two dials that are read at one visit are mounted together.
        """
        first_of_mounting = self._first_of_setup & self.approach.any(axis=1)
        first_of_mounting[1:] &= (np.diff(self.command, axis=0) != 0).any(axis=1)
        moves, order = planned_moves(
            self.command, self.approach, first_of_mounting, self.moves.overshoot
        )
        return replace(self, moves=moves, order=order, line=order + 2)

    @property
    def _first_of_setup(self) -> NDArray[np.bool_]:
        """Which readings are the first of their setup ``(n,)``, booleans."""
        is_first = np.zeros(len(self), dtype=bool)
        is_first[np.unique(self.setup, return_index=True)[1]] = True
        return is_first

    def in_order(self) -> Readings:
        """Return the readings in the order of their rows, from 1, with approaches and moves.

        The approach follows from the row before. The first reading of each setup is approached from
        below on every axis, and repeat visits from the same side again, as only these show the
        noise. A plate is always touched from above. The approach of a distance is unknown, as it is
        not known which end is visited first.
        """
        approach = derive_approach(self.command, np.arange(len(self)))
        approach[self._first_of_setup] = 1.0
        _, first, visit = np.unique(
            np.column_stack([self.setup, self.command]),
            axis=0, return_index=True, return_inverse=True,
        )  # fmt: skip
        approach = approach[first[visit.reshape(-1)]]
        approach[self.touching | self.paired] = 0.0
        sheet = replace(self, approach=approach).with_moves()
        approach[self.touching] = -1.0
        moves = replace(sheet.moves, order=sheet.moves.order + 1)
        return replace(sheet, approach=approach, order=sheet.order + 1, moves=moves)
