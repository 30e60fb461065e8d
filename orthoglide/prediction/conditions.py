"""What the machine saw when a posture was taken, as arrays; equal conditions can be merged."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.errors import InputError, check_word
from orthoglide.geometry import Array
from orthoglide.observations import Campaign


@dataclass(frozen=True)
class Conditions:
    """Conditions of ``n`` postures."""

    command: Array  # rho (n, 3), metres
    approach: Array  # direction of each drive's last move (n, 3): +1, -1, 0 where unknown
    time: Array  # (n,), seconds
    warming: Array  # (n,), kelvin above the first row
    load: Array  # (n,), newtons along base -z at the TCP

    def __len__(self) -> int:
        return len(self.command)

    def part(self, rows: slice) -> Conditions:
        """Some of the postures."""
        return Conditions(*(values[rows] for values in vars(self).values()))

    @classmethod
    def at(
        cls,
        command: ArrayLike,
        *,
        approach: ArrayLike = 0.0,
        time: ArrayLike = 0.0,
        warming: ArrayLike = 0.0,
        load: ArrayLike = 0.0,
        **unknown: ArrayLike,
    ) -> Conditions:
        """Conditions for commands ``(..., 3)``; the rest is broadcast to ``(...)``.

        Raises:
            InputError: for what is no finite number, does not fit the commands, or is no approach,
                and for a condition that there is not.
        """
        rho = np.asarray(command, dtype=float)
        given = {"approach": approach, "time": time, "warming": warming, "load": load}
        for name in unknown:
            check_word("condition", name, given)
        found = {}
        for name, values in given.items():
            own = rho.shape[-1:] if name == "approach" else ()
            if isinstance(values, float) and values == 0.0:  # as mostly
                found[name] = np.zeros((rho.size // 3, *own))
                continue
            try:
                spread = np.broadcast_to(np.asarray(values, float), (*rho.shape[:-1], *own))
            except (TypeError, ValueError):
                raise InputError(
                    f"{name} must be numbers of the shape {(*rho.shape[:-1], *own)}, as there are "
                    f"commands, or one for all"
                ) from None
            if not np.isfinite(spread).all():
                raise InputError(f"{name} must be finite; leave out what is not known")
            found[name] = spread.reshape(-1, *own).copy()
        side = found["approach"]
        if (side * side * side != side).any():
            raise InputError(
                "approach must be +1 or -1, the direction of each drive's last move, or 0 where "
                "unknown"
            )
        return cls(rho.reshape(-1, 3), **found)

    @classmethod
    def of(cls, campaign: Campaign) -> Conditions:
        """Conditions of every row of a campaign; what was not recorded counts as 0."""
        time = np.nan_to_num(campaign.time)
        warming = campaign.temperature_rise
        return cls(campaign.command, campaign.approach, time, warming, campaign.load)

    def merged(self, needs: Collection[str]) -> tuple[Conditions, NDArray[np.intp]]:
        """Distinct conditions and, for each row, which of them it has.

        Args:
            needs: what makes a difference besides the command: ``"approach"``, ``"time"``,
                ``"temperature"``, ``"load"``; the rest is zero.
        """
        table = np.column_stack(
            [
                self.command,
                self.approach * ("approach" in needs),
                self.time * ("time" in needs),
                self.warming * ("temperature" in needs),
                self.load * ("load" in needs),
            ]
        )
        distinct, place = np.unique(table, axis=0, return_inverse=True)
        found = Conditions(distinct[:, :3], distinct[:, 3:6], *distinct[:, 6:].T)
        return found, place.reshape(-1)
