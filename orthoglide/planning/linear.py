"""Linearised readings, and the choice of those with the largest gain.

A reading is ``j x + datum + slope * placement + rounding + noise``: ``j`` is its derivative by the
unknowns ``x``, ``slope`` its derivative by the dial's place along the leg. All readings of a
mounting share the datum and the placement; visits to one station share the rounding; noise is
independent. The part of a further reading that the chosen readings of its mounting do not predict
is ``d x + e``, with variance ``s2`` of ``e``.

So every step is one scalar observation, which adds ``d' d / s2`` to the information on the
unknowns. Two criteria measure its gain: the precision of some combinations of the unknowns, and the
separation of rivals. A mounting begins with two readings: with a free datum, a single one contains
no information.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp

from orthoglide.errors import InputError
from orthoglide.fit import PUBLISHED_REPEATABILITY, common_rounding, noise_of, weight_matrix
from orthoglide.geometry import Array
from orthoglide.instruments.leg_dial import PLACEMENT_INDEX
from orthoglide.machine import Machine
from orthoglide.machine_file import MachineFile
from orthoglide.observations import Readings
from orthoglide.observations.arrays import group_ids
from orthoglide.ordering import largest
from orthoglide.prediction import MeasurementModel, ReadingPoses

Pair = tuple[int, int]
"""Two rivals, the smaller number first."""

_DATUM_SIGMA = 1e-2  # metres: a dial's zero lies within its travel, which is as good as anywhere
_MIN_SIGMA_SHARE = 0.1  # of a reading's sigma: its least part besides the common rounding


@dataclass(frozen=True)
class Steps:
    """Steps that can be taken next, each of one reading, or of two that begin a mounting."""

    # rows of the campaign (k, 2); the first is -1 of a single reading in a mounting that exists
    rows: NDArray[np.int64]
    columns: Array  # `d` (k, P)
    variance: Array  # `s2` (k,), square metres


@dataclass(frozen=True, eq=False)
class LinearReadings:
    """Readings of a campaign or a pool, with their derivatives and standard deviations."""

    campaign: Readings  # without readings
    columns: Array  # derivative of each reading by the unknowns (n, P)
    slope: Array  # derivative of each reading by the dial's place along the leg (n,)
    sigma: Array  # standard deviation of the noise of one visit (n,), metres
    common: float  # standard deviation of the rounding that visits to a station share, metres
    placement: float  # standard deviation of the dial's place along the leg, metres

    @classmethod
    def of(
        cls, machine: Machine, campaign: Readings, names: Sequence[str], noise: float | None = None
    ) -> LinearReadings:
        """Return the readings of a campaign, linearised in parameters or structured members.

        Args:
            machine: about which the readings are linearised.
            campaign: readings of dials; their values do not count.
            names: parameters or structured members, the unknowns, each in units of its tolerance.
            noise: standard deviation of one reading, metres; by default that of the rows, of the
                machine file, or the published one.

        Raises:
            InputError: if there are readings other than of single dials on legs.
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
        _, (row_noise,) = noise_of([campaign], with_repeatability(machine.spec), noise)
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
        """Return readings with known derivatives ``(n, P)`` and poses of their dials.

        ``total`` is the standard deviation of a reading with rounding, metres: one, or ``(n,)``.
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
        """Return the covariance ``(a, b)`` of readings of one mounting with others of it, without
        their noise and for given unknowns, square metres.
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
        """Pairs of readings that begin a mounting: one at the lowest, the median or the highest
        command of the leg, the other at any other reading.
        """
        pairs = []
        for setup, rows in enumerate(self.rows_by_setup):
            if len(rows) < 2:
                continue
            command = self.campaign.command[rows, self.campaign.setups[setup].leg]
            middle = largest(-np.abs(command - np.median(command)))
            anchors = dict.fromkeys([largest(-command), middle, largest(command)])
            pairs += [(rows[a], r) for a in anchors for r in rows if r != rows[a]]
        table = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        first, second = table.T
        columns, slope = (v[second] - v[first] for v in (self.columns, self.slope))
        variance = self.sigma[first] ** 2 + self.sigma[second] ** 2 + 2 * self.common**2
        return Steps(table, columns, variance + (self.placement * slope) ** 2)

    def continuing_steps(self, setup: int, chosen: ArrayLike) -> Steps:
        """Return the steps of one more reading, at any station, in a mounting that exists."""
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
        parts = zip(*((s.rows, s.columns, s.variance) for s in steps), strict=True)
        return Steps(*map(np.concatenate, parts))

    def whitened(self, chosen: Sequence[int] | None = None) -> Array:
        """Return the derivatives ``(m, P)`` of readings whitened to unit variance, with their
        datums projected out.
        """
        rows = np.arange(len(self.campaign))[slice(None) if chosen is None else list(chosen)]
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
    """Return the elementary parameters that ``names`` combine, and the matrix ``(E, P)`` from
    values of ``names`` in tolerances to their values in SI.
    """
    weights_by_name = [machine.catalogue.elementary_weights(name, setups) for name in names]
    parts = tuple(dict.fromkeys(p for weights in weights_by_name for p in weights))
    tolerance = np.array([machine.tolerance(name) for name in names])
    return parts, weight_matrix(parts, weights_by_name) * tolerance


def with_repeatability(spec: MachineFile) -> MachineFile:
    """Return a machine file with the dial's repeatability, the published one if it states none."""
    dial = spec.dial
    return replace(
        spec, dial=replace(dial, repeatability=dial.repeatability or PUBLISHED_REPEATABILITY)
    )


_MAX_READINGS = 500  # readings of a sheet: a day's work, and some minutes to choose
_MIN_GAIN = 1e-9  # gain below which a step is not worth a reading


@dataclass(frozen=True)
class Criterion(ABC):
    """A figure of merit of the information gained so far."""

    information: Array  # on all columns of the readings (P, P), priors in it

    @property
    def reached(self) -> bool:
        """True if no further reading is wanted; the number of readings is the limit otherwise."""
        return False

    @abstractmethod
    def gains(self, steps: Steps) -> Array:
        """Return by how much each step would raise the figure of merit ``(k,)``."""

    def with_step(self, steps: Steps, k: int) -> Self:
        """Return the criterion once step ``k`` has been taken."""
        d, variance = steps.columns[k], steps.variance[k]
        return replace(self, information=self.information + np.outer(d, d) / variance)

    def with_rows(self, readings: LinearReadings, rows: Sequence[int]) -> Self:
        """Return the criterion once rows have been read, in mountings of their own."""
        return replace(self, information=self.information + readings.information(rows))


@dataclass(frozen=True)
class CombinationPrecision(Criterion):
    """Precision of combinations A of the unknowns: ``-log det(A' C A)`` with their covariance C.

    It is D-optimality where A is the identity, and the variance of one combination where A is a
    column.
    """

    combinations: Array  # A (P, m)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the unknowns ``(P, P)``."""
        return np.asarray(np.linalg.inv(self.information))

    @cached_property
    def combination_covariance(self) -> Array:
        """Covariance of the combinations ``(m, m)``."""
        return np.asarray(self.combinations.T @ self.covariance @ self.combinations)

    @property
    def value(self) -> float:
        """Minus the logarithm of the determinant of the combinations' covariance."""
        return -float(np.linalg.slogdet(self.combination_covariance)[1])

    def gains(self, steps: Steps) -> Array:
        """Return ``-log(1 - d C A (A' C A)^-1 A' C d' / (s2 + d C d'))`` (determinant lemma)."""
        dC = steps.columns @ self.covariance
        dCA = dC @ self.combinations
        variance = steps.variance + np.sum(dC * steps.columns, axis=1)
        explained = np.sum(dCA * np.linalg.solve(self.combination_covariance, dCA.T).T, axis=1)
        # Rounding must not let a step explain everything.
        return np.asarray(-np.log1p(-np.minimum(explained / variance, 1 - 1e-12)))


@dataclass(frozen=True)
class RivalSeparation(Criterion):
    """How far rival explanations are separated once the unknowns have been fitted again.

    The last columns of the readings are the predictions of each rival. A step predicts ``e_a``
    under rival a once the unknowns are refitted (``expected`` in `gains`). It raises the expected
    chi2 between rivals a and b by ``(e_a - e_b)^2 / (s2 + d C d')``, where ``d`` is the row of the
    unknowns and ``C`` their covariance.
    """

    prior_covariance: Array  # of the unknowns before any step, the mean of all rivals' (P, P)
    pairs: Array  # of rivals (q, 2)
    required_chi2: float = np.inf  # chi2 beyond which no more is wanted

    @classmethod
    def before(
        cls, covariances: Sequence[Array], pairs: Sequence[Pair], required_chi2: float = np.inf
    ) -> Self:
        """Return the criterion before any step, by each rival's covariance of the unknowns."""
        prior = np.mean(covariances, axis=0)
        information = np.zeros((len(prior) + len(covariances),) * 2)
        return cls(information, prior, np.array(pairs), required_chi2)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the unknowns once fitted again ``(P, P)``."""
        size = len(self.prior_covariance)
        update = np.eye(size) + self.information[:size, :size] @ self.prior_covariance
        # (C^-1 + W)^-1 = C (1 + W C)^-1, whatever C's rank.
        return np.asarray(self.prior_covariance @ np.linalg.inv(update))

    @cached_property
    def chi2(self) -> Array:
        """Expected chi2 of one rival where the other is true ``(q,)``."""
        size, W = len(self.prior_covariance), self.information
        R = W[size:, size:] - W[size:, :size] @ self.covariance @ W[:size, size:]
        a, b = self.pairs.T
        return np.maximum(R[a, a] + R[b, b] - 2 * R[a, b], 0.0)

    @property
    def sigmas(self) -> dict[Pair, float]:
        """Separation of each pair, the root of its chi2."""
        pairs = map(tuple, self.pairs.tolist())
        return dict(zip(pairs, np.sqrt(self.chi2).tolist(), strict=True))

    @property
    def reached(self) -> bool:
        """True if even the least separated pair is separated enough."""
        return bool(self.chi2.min() >= self.required_chi2)

    @property
    def value(self) -> float:
        """Minus the logarithm of the mean relative likelihood of the wrong rivals."""
        return float(np.log(len(self.chi2)) - logsumexp(-self.chi2 / 2))

    def gains(self, steps: Steps) -> Array:
        """Return the rise of ``value``."""
        size, (a, b) = len(self.prior_covariance), self.pairs.T
        unknowns, predicted = steps.columns[:, :size], steps.columns[:, size:]
        fitted = unknowns @ self.covariance
        expected = predicted - fitted @ self.information[:size, size:]
        variance = np.sum(fitted * unknowns, axis=1) + steps.variance
        chi2 = self.chi2 + (expected[:, a] - expected[:, b]) ** 2 / variance[:, None]
        return np.asarray(np.log(len(self.chi2)) - logsumexp(-chi2 / 2, axis=1) - self.value)


C = TypeVar("C", bound=Criterion)


def choose(
    readings: LinearReadings, start: C, count: int, *, mounting_cost: float = 2.0
) -> tuple[tuple[int, ...], C]:
    """Choose readings greedily by gain per cost; return their rows in the pool (a row may occur
    twice) and the final criterion.

    Args:
        readings: the pool.
        start: the criterion before any of them.
        count: largest number of readings.
        mounting_cost: cost of mounting a dial and taking its first two readings, in readings.

    Raises:
        InputError: if the number of readings is not whole, or out of range.
    """
    if not isinstance(count, Real) or not 2 <= count <= _MAX_READINGS or count % 1:
        raise InputError(
            f"{count!r} readings cannot be chosen: give a whole number from 2 to {_MAX_READINGS}. "
            f"A single reading only determines the datum of its setup"
        )
    taken, criterion = list[int](), start
    while len(taken) < count and not (taken and criterion.reached):
        steps = readings.next_steps(taken, int(count) - len(taken))
        if not len(steps.rows):
            break
        gains = criterion.gains(steps)
        k = largest(gains / np.where(steps.rows[:, 0] >= 0, mounting_cost, 1.0))
        if not gains[k] > _MIN_GAIN:
            break
        criterion = criterion.with_step(steps, k)
        taken += [row for row in steps.rows[k].tolist() if row >= 0]
    return tuple(taken), criterion
