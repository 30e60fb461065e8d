"""The tool's error by its independent sources, of a machine that a sheet calibrates or none.

The tool's error is linear in independent sources of unit variance: the errors of the parameters,
each in its tolerance, and the noise of the readings. Without calibration it is ``S s z``, with S
the shape of the TCP over the workspace by parameter and s the common scale of the tolerances. A
calibration with the gain ``K = (s^-2 + W^T W)^-1 W^T`` of whitened readings ``W s z + n`` leaves
``S (1 - K W) s z - S K n``. Variances of sources add, so each has its share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.accuracy import tcp_slopes, without_place
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign
from orthoglide.observations.protocols import check_dials
from orthoglide.planning.linear import LinearReadings, foreseen
from orthoglide.posterior import with_everything


@dataclass(frozen=True, eq=False)
class ToolError:
    """The tool's error by its sources at one scale of the tolerances."""

    field: Array  # of each machine parameter, in the scaled tolerances (g, 3, P), metres
    read: Array  # of each of the readings and the dials' own parameters (g, 3, m), metres
    effects: tuple[str, ...]  # of the parameters

    @property
    def by_effect(self) -> dict[str, float]:
        """Mean squared error over the workspace that each effect makes."""
        each = np.sum(self.field**2, axis=(0, 1)) / len(self.field)
        found = dict.fromkeys(self.effects, 0.0)
        for effect, part in zip(self.effects, each.tolist(), strict=True):
            found[effect] += part
        return found

    @property
    def noise(self) -> float:
        """Mean squared error that the readings make."""
        return float(np.sum(self.read**2)) / len(self.field)

    @property
    def covariance(self) -> Array:
        """Of the tool over the workspace ``(g, 3, 3)``, square metres."""
        every = np.concatenate([self.field, self.read], axis=2)
        return np.asarray(every @ every.transpose(0, 2, 1))

    def scaled(self, factors: Mapping[str, float]) -> ToolError:
        """Effects at other tolerances, calibrated as before."""
        by = np.array([factors[e] for e in self.effects])
        return replace(self, field=self.field * by)


@dataclass(frozen=True, eq=False)
class Sources:
    """What makes the tool's error."""

    slopes: Array  # TCP's shape by machine parameter in its tolerance (g, 3, P), metres
    effects: tuple[str, ...]  # of the parameters
    # whitened readings by these and by the dials' own (m, P + D); none without a calibration
    rows: Array | None

    @classmethod
    def of(cls, machine: Machine, sheet: Campaign | None, noise: float | None) -> Sources:
        """Of a machine without errors; arguments as of ``needed_tolerances``."""
        catalogue, pitch = machine.catalogue, machine.spec.screw_pitch
        counted = [e for e in catalogue.values() if e.at_rest and (pitch or "pitch" not in e.needs)]
        names = [str(n) for e in counted for n in e.motions]
        rows = None
        if sheet is not None:
            names, rows = _readings(machine, names, sheet, noise)
        tolerance = np.array([machine.tolerance(n) for n in names])
        slopes = without_place(tcp_slopes(machine, names)) * tolerance
        return cls(slopes, tuple(catalogue.effect_of(n).name for n in names), rows)

    def at(self, scale: float) -> ToolError:
        """The tool's error with all tolerances of the machine scaled."""
        count = self.slopes.shape[2]
        if self.rows is None:
            return ToolError(
                scale * self.slopes, np.zeros((*self.slopes.shape[:2], 0)), self.effects
            )
        sd = np.ones(self.rows.shape[1])
        sd[:count] = scale
        seen = self.rows * sd  # by sources of unit variance
        inner = np.linalg.inv(np.eye(len(sd)) + seen.T @ seen)
        tool = scale * self.slopes
        # 1 - K W = inner, and K = inner seen^T: of the noise its covariance is all that counts.
        kept, by_noise = inner[:count], inner[:count] @ seen.T
        read = np.concatenate([tool @ kept[:, count:], tool @ by_noise], axis=2)
        return ToolError(tool @ kept[:, :count], read, self.effects)


def _readings(
    machine: Machine, names: Sequence[str], sheet: Campaign, noise: float | None
) -> tuple[list[str], Array]:
    """Machine parameters that the sheet may show or that move the tool, and the whitened rows by
    these and by the dials' own.
    """
    check_dials(machine.geometry)
    problem = foreseen(machine, sheet, noise)
    wide = with_everything(problem)
    of_dial = [n for n in wide.names if machine.catalogue.effect_of(n).of_dial]
    shown = (n for n in wide.names if n not in of_dial)
    kept = list(dict.fromkeys([*map(str, names), *map(str, shown)]))
    (exact,) = problem.campaigns
    return kept, LinearReadings.of(machine, exact, [*kept, *of_dial], noise).whitened()
