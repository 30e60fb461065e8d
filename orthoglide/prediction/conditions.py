"""Conditions under which postures were taken, as arrays; equal conditions can be merged."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.errors import InputError, check_choice
from orthoglide.geometry import Array
from orthoglide.observations import Readings
from orthoglide.observations.arrays import group_ids

_COLUMNS: dict[str, int | slice] = {"approach": slice(3, 6), "time": 6, "warming": 7, "load": 8}


@dataclass(frozen=True)
class Conditions:
    """Conditions of ``n`` postures.

    Attributes:
        table: ``(n, 9)``: command, approach, time, warming and load, SI.
    """

    table: Array

    def __len__(self) -> int:
        return len(self.table)

    @property
    def command(self) -> Array:
        """Commands rho ``(n, 3)``, metres."""
        return self.table[:, :3]

    @property
    def approach(self) -> Array:
        """Direction of each drive's last move ``(n, 3)``: +1, -1, 0 where unknown."""
        return self.table[:, 3:6]

    @property
    def time(self) -> Array:
        """Seconds ``(n,)``."""
        return self.table[:, 6]

    @property
    def warming(self) -> Array:
        """Kelvin above the first row ``(n,)``."""
        return self.table[:, 7]

    @property
    def load(self) -> Array:
        """Newtons along base -z at the TCP ``(n,)``."""
        return self.table[:, 8]

    def subset(self, rows: NDArray[np.intp] | slice) -> Conditions:
        """Return some of the postures, by their numbers ``(k,)`` or as a slice."""
        return Conditions(self.table[rows])

    def with_time(self, time: Array) -> Conditions:
        """Return the postures at other seconds ``(n,)``."""
        table = self.table.copy()
        table[:, _COLUMNS["time"]] = time
        return Conditions(table)

    @classmethod
    def from_commands(cls, command: ArrayLike, **others: ArrayLike) -> Conditions:
        """Return conditions for commands ``(..., 3)``.

        Args:
            command: rho, metres.
            others: ``approach (..., 3)``, and ``time``, ``warming``, ``load`` ``(...)``, or one for
                all; 0 where not given.

        Raises:
            InputError: for values that are not finite, do not fit the commands or are no approach,
                and for an unknown condition.
        """
        rho = np.asarray(command, dtype=float)
        table = np.zeros((rho.size // 3, 9))
        table[:, :3] = rho.reshape(-1, 3)
        for name, values in others.items():
            check_choice("condition", name, _COLUMNS)
            columns = _COLUMNS[name]
            shape = rho.shape if name == "approach" else rho.shape[:-1]
            try:
                column = np.broadcast_to(np.asarray(values, float), shape)
            except (TypeError, ValueError):
                raise InputError(
                    f"{name} must be numbers of the shape {shape}, as there are commands, or one "
                    f"for all"
                ) from None
            if not np.isfinite(column).all():
                raise InputError(f"{name} must be finite; leave out what is not known")
            table[:, columns] = column.reshape(table[:, columns].shape)
        approach = table[:, 3:6]
        if "approach" in others and (approach * approach * approach != approach).any():
            raise InputError(
                "approach must be +1 or -1, the direction of each drive's last move, or 0 where "
                "unknown"
            )
        return cls(table)

    @classmethod
    def from_readings(cls, readings: Readings) -> Conditions:
        """Return the conditions of every reading; 0 where they were not recorded."""
        columns = (
            readings.command, readings.approach, np.nan_to_num(readings.time),
            readings.temperature_rise, readings.load,
        )  # fmt: skip
        return cls(np.column_stack(columns))

    def merged(self, needs: Collection[str]) -> tuple[Conditions, NDArray[np.intp]]:
        """Return the distinct conditions and, for each row, the index of its own among them.

        Args:
            needs: the conditions that matter besides the command: ``"approach"``, ``"time"``,
                ``"temperature"``, ``"load"``; others are set to zero.
        """
        names = ("approach", "approach", "approach", "time", "temperature", "load")
        table = self.table * [1.0, 1.0, 1.0, *(name in needs for name in names)]
        posture = group_ids(table)
        return Conditions(table[np.unique(posture, return_index=True)[1]]), posture
