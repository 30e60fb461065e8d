"""Readings linearised in the parameters asked for, and the information of one further reading.

A reading is ``j x + datum + slope * place + rounding + noise``. Within a mounting the last four
make readings correlated; a further reading, less what the chosen ones of its mounting predict of
it, is ``d x + e`` with ``e`` independent of all else and of variance ``s2``. So every step is one
scalar observation, and its gain by any criterion is a formula. A mounting begins with two readings:
with a free datum, a single one contains no information.
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
from orthoglide.prediction import MeasurementModel, ReadingPoses
from orthoglide.simulation import simulate

_DATUM_SIGMA = 1e-2  # metres: a dial's zero lies within its travel, which is as good as anywhere
_MIN_SIGMA_SHARE = 0.1  # of a reading's sigma: its least part besides the common rounding


@dataclass(frozen=True)
class Steps:
    """Readings that can be taken next."""

    rows: NDArray[np.int64]  # of the campaign (k, 2); first -1 where the mounting stands already
    columns: Array  # `d` (k, P)
    variance: Array  # `s2` (k,), square metres

    @property
    def opens_mounting(self) -> NDArray[np.bool_]:
        """True for steps that mount a dial ``(k,)``."""
        return np.asarray(self.rows[:, 0] >= 0)

    @classmethod
    def joined(cls, steps: Sequence[Steps]) -> Steps:
        """Return several sets of steps as one."""
        parts = zip(*((s.rows, s.columns, s.variance) for s in steps), strict=True)
        return cls(*map(np.concatenate, parts))


@dataclass(frozen=True, eq=False)
class LinearReadings:
    """Readings of a campaign or a pool, with their derivatives and what they scatter by."""

    campaign: Readings  # without readings
    columns: Array  # derivative of each reading (n, P) by the parameters asked for
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
        at = MeasurementModel(campaign).linearise(machine.model, machine.values, parts)
        _, (row_noise,) = noise_of([campaign], _with_repeatability(machine.spec), noise)
        total = np.hypot(row_noise.sigma, row_noise.common)
        return cls.from_columns(machine, campaign, at.jacobian @ weights, at.reading_poses, total)

    @classmethod
    def from_columns(
        cls,
        machine: Machine,
        campaign: Readings,
        columns: Array,
        poses: ReadingPoses,
        total: ArrayLike,
    ) -> LinearReadings:
        """Return readings by their derivatives ``(n, P)``, and by the poses of their dials.

        ``total`` is the standard deviation of one reading with rounding, metres, or ``(n,)``.
        """
        dial = machine.spec.dial
        sd = np.broadcast_to(np.asarray(total, dtype=float), (len(campaign),))
        common = float(common_rounding(np.sqrt(np.mean(sd**2)), dial.resolution))
        sigma = np.sqrt(np.maximum(sd**2 - common**2, (_MIN_SIGMA_SHARE * sd) ** 2))
        slope = poses.nuisance_jacobian[:, PLACEMENT_INDEX]
        return cls(campaign, columns, slope, sigma, common, dial.placement)

    @cached_property
    def station(self) -> NDArray[np.intp]:
        """Station of each row ``(n,)``."""
        return group_ids(self.campaign.stations)

    def covariance(self, rows: ArrayLike, other_rows: ArrayLike) -> Array:
        """Return the covariance ``(a, b)`` of readings of one mounting with others, noise left out
        and parameters given.
        """
        i, j = np.asarray(rows, dtype=np.int64), np.asarray(other_rows, dtype=np.int64)
        slopes = np.multiply.outer(self.slope[i], self.slope[j])
        shared = np.equal.outer(self.station[i], self.station[j]) * self.common**2
        return np.asarray(_DATUM_SIGMA**2 + self.placement**2 * slopes + shared)

    @cached_property
    def rows_by_setup(self) -> tuple[NDArray[np.intp], ...]:
        """Rows of each setup."""
        setups = range(len(self.campaign.setups))
        return tuple(np.flatnonzero(self.campaign.setup == k) for k in setups)

    @cached_property
    def opening_steps(self) -> Steps:
        """Pairs of readings to begin a mounting with: one at zero or an end, one anywhere else."""
        pairs = []
        for setup, rows in enumerate(self.rows_by_setup):
            if len(rows) < 2:
                continue
            travel = self.campaign.command[rows, self.campaign.setups[setup].leg]
            middle = largest(-np.abs(travel - np.median(travel)))
            anchors = dict.fromkeys([largest(-travel), middle, largest(travel)])
            pairs += [(rows[a], r) for a in anchors for r in rows if r != rows[a]]
        table = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        first, second = table.T
        columns, slope = (v[second] - v[first] for v in (self.columns, self.slope))
        variance = self.sigma[first] ** 2 + self.sigma[second] ** 2 + 2 * self.common**2
        return Steps(table, columns, variance + (self.placement * slope) ** 2)

    def continuing_steps(self, setup: int, chosen: ArrayLike) -> Steps:
        """Return the steps of one more reading, at any station, in a mounting that stands."""
        rows, taken = self.rows_by_setup[setup], np.asarray(chosen)
        among = self.covariance(taken, taken) + np.diag(self.sigma[taken] ** 2)
        across = self.covariance(rows, taken)
        weights = np.linalg.solve(among, across.T).T
        alone = self.sigma[rows] ** 2 + (self.placement * self.slope[rows]) ** 2
        alone += _DATUM_SIGMA**2 + self.common**2
        return Steps(
            np.column_stack([np.full(len(rows), -1), rows]),
            self.columns[rows] - weights @ self.columns[taken],
            alone - np.sum(weights * across, axis=1),
        )

    def next_steps(self, chosen: Sequence[int], readings_left: int) -> Steps:
        """Return all steps that ``readings_left`` further readings allow, after those chosen."""
        taken = np.asarray(chosen, dtype=np.int64)
        setup_taken = self.campaign.setup[taken]
        mounted = [*dict.fromkeys(setup_taken.tolist())]
        steps = [self.continuing_steps(k, taken[setup_taken == k]) for k in mounted]
        if readings_left >= 2:
            opening = self.opening_steps
            new = ~np.isin(self.campaign.setup[opening.rows[:, 0]], mounted)
            steps.insert(0, Steps(opening.rows[new], opening.columns[new], opening.variance[new]))
        return Steps.joined(steps)

    def whitened(self, chosen: Sequence[int] | None = None) -> Array:
        """Return rows ``(m, P)`` by the unknowns with unit variance, datums projected out."""
        rows = np.arange(len(self.campaign))
        rows = rows if chosen is None else rows[list(chosen)]
        blocks = [np.empty((0, self.columns.shape[1]))]
        for setup in np.unique(self.campaign.setup[rows]):
            k = rows[self.campaign.setup[rows] == setup]
            root = np.linalg.cholesky(self.covariance(k, k) + np.diag(self.sigma[k] ** 2))
            whitened = np.linalg.solve(root, np.column_stack([np.ones(len(k)), self.columns[k]]))
            datum, columns = whitened[:, :1] / np.linalg.norm(whitened[:, 0]), whitened[:, 1:]
            blocks.append(columns - datum @ (datum.T @ columns))
        return np.concatenate(blocks)

    def information(self, chosen: Sequence[int] | None = None) -> Array:
        """Return the information of chosen rows, or of all, on the unknowns ``(P, P)``."""
        rows = self.whitened(chosen)
        return np.asarray(rows.T @ rows)


def elementary_weights(
    machine: Machine, names: Sequence[str], setups: tuple[str, ...] = ()
) -> tuple[tuple[str, ...], Array]:
    """Return elementary parameters, and the matrix ``(E, P)`` to them from names in tolerances."""
    weights_by_name = [machine.catalogue.elementary_weights(name, setups) for name in names]
    parts = tuple(dict.fromkeys(p for weights in weights_by_name for p in weights))
    tolerance = np.array([machine.tolerance(name) for name in names])
    return parts, weight_matrix(parts, weights_by_name) * tolerance


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
    rated = replace(machine, spec=_with_repeatability(machine.spec))
    # Predictions are exact, so the noise is declared: it cannot be estimated from their repeats.
    sheets = [sheet] if isinstance(sheet, Readings) else sheet
    if not len(sheets):
        raise InputError("there are no readings: give at least one table of them")
    predicted = [simulate(machine, readings, exact=True) for readings in sheets]
    for k, readings in enumerate(predicted):
        if readings.of_tool:
            predicted[k] = replace(readings, sigma=expected_sigma(readings, machine.spec))
    return assemble(predicted, rated, machine.catalogue.base, noise=noise)
