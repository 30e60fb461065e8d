"""Readings linearised in what is asked for: what each, and one more, would tell.

A reading is ``j x + datum + slope * place + rounding + noise``. Within a mounting the last four
make readings correlated; a further reading, less what the chosen ones of its mounting predict of
it, is ``d x + e`` with ``e`` independent of all else and of variance ``s2``. So every step is one
scalar observation, and its gain by any criterion is a formula. A mounting begins with two readings:
with a free datum, one says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orthoglide.errors import InputError
from orthoglide.fit import (
    PUBLISHED_REPEATABILITY,
    Problem,
    assemble,
    common_rounding,
    expected_sigma,
    noise_of,
    weight_matrix,
)
from orthoglide.geometry import Array
from orthoglide.instruments.leg_dial import PLACEMENT_INDEX
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile
from orthoglide.observations import Readings
from orthoglide.observations.arrays import group_ids
from orthoglide.ordering import largest
from orthoglide.simulation import simulate

_DATUM_SIGMA = 1e-2  # metres: a dial's zero lies within its travel, which is as good as anywhere
_MIN_SIGMA_SHARE = (
    0.1  # of a reading's sigma: what is left of it besides the rounding that repeats share
)


@dataclass(frozen=True)
class Steps:
    """Readings that can be taken next."""

    # of the campaign (k, 2); the first is -1 where the mounting stands already
    rows: NDArray[np.int64]
    columns: Array  # `d` (k, P)
    variance: Array  # `s2` (k,), square metres

    @property
    def opens_mounting(self) -> NDArray[np.bool_]:
        """True for steps that mount a dial ``(k,)``."""
        return np.asarray(self.rows[:, 0] >= 0)

    def rows_of_step(self, k: int) -> list[int]:
        """Return the rows of the campaign that step ``k`` reads."""
        return [int(r) for r in self.rows[k] if r >= 0]


@dataclass(frozen=True, eq=False)
class LinearReadings:
    """Readings of a campaign or a pool, with their derivatives and what they scatter by."""

    campaign: Readings  # without readings
    columns: Array  # derivative of each reading (n, P) by whatever is asked for
    slope: Array  # by the dial's place (n,)
    sigma: Array  # standard deviation of one visit (n,), metres
    common: float  # of the rounding that all visits to a station share, metres
    placement: float  # of the dial's place along the leg, metres

    @classmethod
    def of(
        cls, machine: Machine, campaign: Readings, names: Sequence[str], noise: float | None = None
    ) -> LinearReadings:
        """Return the readings linearised in parameters, each in its tolerance.

        Args:
            machine: as it is believed to be.
            campaign: readings, if there are any, do not count.
            names: parameters or structured members.
            noise: standard deviation of one reading, metres; else of the rows, the machine file,
                or as published.

        Raises:
            InputError: where these are other readings than of single dials.
        """
        if any(s.observation.dials != 1 for s in campaign.setups):
            kinds = ", ".join(dict.fromkeys(campaign.kind))
            raise InputError(
                f"{campaign.name}: only readings of single dials on legs are planned one by one, "
                f"and these are of kind {kinds}: smallest_effects says what they show"
            )
        setups = tuple(s.name for s in campaign.setups)
        parts, weights = elementary_weights(machine, names, setups)
        at = machine.model.linearised(machine.values, campaign, parts)
        _, (rows,) = noise_of([campaign], _with_repeatability(machine.spec), noise)
        total = np.hypot(rows.sigma, rows.common)
        slope = at.reading_poses.nuisance_jacobian[:, PLACEMENT_INDEX]
        return cls.from_columns(machine, campaign, at.jacobian @ weights, slope, total)

    @classmethod
    def from_columns(
        cls, machine: Machine, campaign: Readings, columns: Array, slope: Array, total: ArrayLike
    ) -> LinearReadings:
        """Return readings whose derivatives are known.

        Args:
            machine: its dial.
            campaign: without readings.
            columns: derivatives ``(n, P)``.
            slope: by the dial's place ``(n,)``.
            total: standard deviation of one reading, rounding counted, metres; a number or
                ``(n,)``.
        """
        dial = machine.spec.dial
        sd = np.broadcast_to(np.asarray(total, dtype=float), (len(campaign),))
        common = float(common_rounding(np.sqrt(np.mean(sd**2)), dial.resolution))
        sigma = np.sqrt(np.maximum(sd**2 - common**2, (_MIN_SIGMA_SHARE * sd) ** 2))
        return cls(campaign, columns, slope, sigma, common, dial.placement)

    @cached_property
    def station(self) -> NDArray[np.intp]:
        """Station of each row ``(n,)``."""
        return group_ids(self.campaign.stations)

    def covariance(self, one: ArrayLike, other: ArrayLike) -> Array:
        """Return the covariance ``(a, b)`` of visits in a mounting, parameters and datum given."""
        i, j = np.asarray(one, dtype=np.int64), np.asarray(other, dtype=np.int64)
        slopes = np.multiply.outer(self.slope[i], self.slope[j])
        shared = np.equal.outer(self.station[i], self.station[j]) * self.common**2
        return np.asarray(self.placement**2 * slopes + shared)

    def visit_covariance(self) -> Array:
        """Return the covariance of one visit to each row ``(n, n)``, parameters given, datums
        within a dial's travel.
        """
        rows = np.arange(len(self.campaign))
        together = np.equal.outer(self.campaign.setup, self.campaign.setup)
        shared = np.where(together, self.covariance(rows, rows) + _DATUM_SIGMA**2, 0.0)
        return np.asarray(shared + np.diag(self.sigma**2))

    @cached_property
    def rows_by_setup(self) -> tuple[NDArray[np.intp], ...]:
        """Rows of each setup."""
        setups = range(len(self.campaign.setups))
        return tuple(np.flatnonzero(self.campaign.setup == k) for k in setups)

    @cached_property
    def opening_steps(self) -> Steps:
        """Pairs of readings to begin a mounting with: one at zero or an end, one anywhere else."""
        pairs = []
        for rows in self.rows_by_setup:
            if len(rows) < 2:
                continue
            leg = self.campaign.setups[self.campaign.setup[rows[0]]].leg
            own = self.campaign.command[rows, leg]
            middle = largest(-np.abs(own - np.median(own)))
            anchors = dict.fromkeys([largest(-own), middle, largest(own)])
            pairs += [(rows[a], r) for a in anchors for r in rows if r != rows[a]]
        table = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        first, second = table.T
        single = self.sigma[first] ** 2 + self.sigma[second] ** 2 + 2 * self.common**2
        apart = self.slope[second] - self.slope[first]
        return Steps(
            table,
            self.columns[second] - self.columns[first],
            single + (self.placement * apart) ** 2,
        )

    def continuing_steps(self, setup: int, chosen: Sequence[int]) -> Steps:
        """Return the steps of one more reading, at any station, in a mounting that stands."""
        rows, done = self.rows_by_setup[setup], np.asarray(chosen)
        among = self.covariance(done, done) + _DATUM_SIGMA**2 + np.diag(self.sigma[done] ** 2)
        across = self.covariance(rows, done) + _DATUM_SIGMA**2
        weights = np.linalg.solve(among, across.T).T
        single = self.covariance(rows, rows).diagonal() + _DATUM_SIGMA**2 + self.sigma[rows] ** 2
        return Steps(
            np.column_stack([np.full(len(rows), -1), rows]).astype(np.int64),
            self.columns[rows] - weights @ self.columns[done],
            single - np.sum(weights * across, axis=1),
        )

    def next_steps(self, chosen: Sequence[int], room: int) -> Steps:
        """Return all steps that ``room`` further readings allow, after those chosen."""
        standing = dict.fromkeys(int(self.campaign.setup[k]) for k in chosen)
        parts = []
        if room >= 2:
            every = self.opening_steps
            new = ~np.isin(self.campaign.setup[every.rows[:, 0]], list(standing))
            parts.append(Steps(every.rows[new], every.columns[new], every.variance[new]))
        for setup in standing:
            parts.append(
                self.continuing_steps(setup, [k for k in chosen if self.campaign.setup[k] == setup])
            )
        return Steps(
            np.concatenate([p.rows for p in parts]),
            np.concatenate([p.columns for p in parts]),
            np.concatenate([p.variance for p in parts]),
        )

    def whitened(self, chosen: Sequence[int] | None = None) -> Array:
        """Return rows ``(m, P)`` by the unknowns with unit variance, datums projected out."""
        every = np.arange(len(self.campaign))
        rows = every if chosen is None else every[list(chosen)]
        blocks = [np.empty((0, self.columns.shape[1]))]
        for setup in np.unique(self.campaign.setup[rows]):
            own = rows[self.campaign.setup[rows] == setup]
            root = np.linalg.cholesky(self.covariance(own, own) + np.diag(self.sigma[own] ** 2))
            both = np.linalg.solve(root, np.column_stack([np.ones(len(own)), self.columns[own]]))
            datum = both[:, :1] / np.linalg.norm(both[:, 0])
            blocks.append(both[:, 1:] - datum @ (datum.T @ both[:, 1:]))
        return np.concatenate(blocks)

    def information(self, chosen: Sequence[int] | None = None) -> Array:
        """Return the information of chosen rows, or of all, on the unknowns ``(P, P)``."""
        rows = self.whitened(chosen)
        return np.asarray(rows.T @ rows)


def elementary_weights(
    machine: Machine, names: Sequence[str], setups: tuple[str, ...] = ()
) -> tuple[tuple[str, ...], Array]:
    """Return the elementary parameters that names stand for, and the matrix ``(E, P)`` from one
    tolerance of each name to them, SI.
    """
    stands_for = [machine.catalogue.elementary_weights(name, setups) for name in names]
    parts = tuple(dict.fromkeys(p for weights in stands_for for p in weights))
    tolerance = np.array([machine.tolerance(name) for name in names])
    return parts, weight_matrix(parts, stands_for) * tolerance


def _with_repeatability(spec: MachineFile) -> MachineFile:
    """Return a machine file with the dial's repeatability, as published where it states none."""
    dial = spec.dial
    return replace(
        spec, dial=replace(dial, repeatability=dial.repeatability or PUBLISHED_REPEATABILITY)
    )


def predicted_problem(
    machine: Machine, sheet: Readings | Sequence[Readings], noise: float | None = None
) -> Problem:
    """Return the problem of zeros and lengths on the readings predicted for sheets."""
    careful = replace(machine, spec=_with_repeatability(machine.spec))
    # Exact, with their noise declared: repeats that agree are no witnesses of it.
    sheets = [sheet] if isinstance(sheet, Readings) else sheet
    several = [simulate(machine, one, exact=True) for one in sheets]
    for k, one in enumerate(several):
        if one.of_tool:
            several[k] = replace(one, sigma=expected_sigma(one, machine.spec))
    return assemble(several, careful, machine.catalogue.base, noise=noise)
