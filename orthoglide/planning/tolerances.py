"""Which tolerances a wanted error of the tool needs, calibrated by a sheet or not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orthoglide.accuracy import mean_length, tcp_slopes, without_place
from orthoglide.errors import InputError
from orthoglide.frames import Framed, html_table
from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings
from orthoglide.observations.protocols import check_dials
from orthoglide.ordering import ranked
from orthoglide.planning.linear import LinearReadings, foreseen
from orthoglide.posterior import with_everything
from orthoglide.threads import on_one_thread
from orthoglide.units import Unit

LARGEST = 1e3
"""Scale of the tolerances from which on any will do."""

_WHY = "by side of approach, load, warmth or time alone, or by a screw pitch that the file lacks"


@dataclass(frozen=True)
class NeededTolerance:
    """One effect in the budget of tolerances, SI."""

    effect: str  # its name
    tolerance: float  # of the machine file
    share: float  # of the tool's error, as a share of its variance, all tolerances scaled alike
    scaled: float  # tolerance needed if all are scaled alike
    equal: float  # tolerance needed if all effects make the same share of the tool's error
    unit: Unit  # of its parameters in files


@dataclass(frozen=True)
class NeededTolerances(Framed):
    """Tolerances that a wanted error of the tool needs."""

    wanted: float  # mean over the workspace and machines after the best translation, metres
    now: float  # the same at the tolerances of the machine file, metres
    scale: float  # of all tolerances that gives what is wanted; infinite where any will do
    effects: tuple[NeededTolerance, ...]  # what costs most first
    noise: float  # share of the readings and their dials in the tool's error; 0 without calibration
    sheet: str  # by which the machine is calibrated; empty where it is not
    # effects of the machine that make no error of the tool at rest and in the middle of the dead
    # band
    left_out: tuple[str, ...]
    _index = "effect"

    @property
    def columns(self) -> dict[str, list[Any]]:
        """A row an effect, what costs most first, in the units of files."""
        rows = [
            (e.effect, e.tolerance / e.unit.si, e.share, e.scaled / e.unit.si, e.equal / e.unit.si,
             e.unit.name)
            for e in self.effects
        ]  # fmt: skip
        titles = ("effect", "tolerance", "share", "all_alike", "equal_shares", "unit")
        return dict(zip(titles, map(list, zip(*rows, strict=True)), strict=True))

    def __str__(self) -> str:
        how = f"Calibrated by {self.sheet}" if self.sheet else "Not calibrated"
        needed = f"needs all of them times {self.scale:.3g}"
        if self.scale == np.inf:
            needed = "is kept with any"
        elif self.scale > 1:
            needed = f"allows all of them times {self.scale:.3g}"
        lines = [
            f"{how}: {self.now * 1e3:.3g} mm at the tolerances of the machine file; "
            f"{self.wanted * 1e3:.3g} mm {needed}",
            "",
            f"{'effect':<20}{'tolerance':>11}{'share':>9}{'all alike':>11}{'equal shares':>14}  "
            "unit",
        ]
        for name, now, share, alike, equal, unit in zip(*self.columns.values(), strict=True):
            figures = f"{now:>11.3g}{100 * share:>7.1f} %{alike:>11.3g}{equal:>14.3g}"
            lines.append(f"{name:<20}{figures}  {unit}")
        if self.sheet:
            lines.append(f"{'the readings':<20}{'':>11}{100 * self.noise:>7.1f} %")
        if self.left_out:
            lines.append(f"not counted: {', '.join(self.left_out)} ({_WHY})")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return html_table(str(self).partition("\n")[0], self.columns)


@on_one_thread
def needed_tolerances(
    machine: MachineSource, wanted: float, sheet: Readings | None = None, noise: float | None = None
) -> NeededTolerances:
    """The tolerances that a wanted error of the tool needs, by linear propagation.

    Args:
        machine: dimensions, tolerances and dial; its parameters do not count.
        wanted: mean error over the workspace and over machines after the best translation, metres.
        sheet: readings by which each machine is calibrated, all effects allowed for; none where
            absent.
        noise: standard deviation of one reading, metres.

    Raises:
        InputError: for an error that is no positive length.
    """
    if not 0 < wanted < 1:
        raise InputError(f"the wanted error must be a positive length in metres, not {wanted}")
    machine = Machine.of(machine)
    sources = Sources.of(machine.with_only({}), sheet, noise)
    now = mean_length(sources.at(1.0).covariance)
    scale = _scale(sources, wanted, now)
    there = sources.at(min(scale, LARGEST))
    parts = there.by_effect
    total = sum(parts.values()) + there.noise
    catalogue = machine.catalogue
    equal = _equal_shares(there, wanted) if scale < np.inf else dict.fromkeys(parts, 1.0)
    rows = [
        NeededTolerance(
            effect, machine.tolerance(effect), part / total, scale * machine.tolerance(effect),
            scale * equal[effect] * machine.tolerance(effect),
            catalogue[effect].unit,
        )
        for effect, part in parts.items()
        if part > 0
    ]  # fmt: skip
    left_out = [e.name for e in catalogue.values() if not e.of_dial and not parts.get(e.name)]
    return NeededTolerances(
        wanted, now, scale, tuple(ranked(rows, lambda row: row.share)), there.noise / total,
        "" if sheet is None else sheet.name, tuple(left_out),
    )  # fmt: skip


def _scale(sources: Sources, wanted: float, now: float) -> float:
    """Of all tolerances that gives the wanted error; infinite where any will do."""
    if sources.rows is None:
        return wanted / now

    from scipy.optimize import brentq

    def beyond(log: float) -> float:
        return mean_length(sources.at(float(np.exp(log))).covariance) - wanted

    # A calibrated machine's error grows with its tolerances, and by no more than these.
    low, high = min(0.0, float(np.log(wanted / now))), float(np.log(LARGEST))
    if beyond(high) < 0:
        return float("inf")
    while beyond(low) > 0:
        low -= 1.0
    return float(np.exp(brentq(beyond, low, high)))


def _equal_shares(there: ToolError, wanted: float) -> dict[str, float]:
    """Factors of the tolerances at which all effects make the same share of the wanted error."""
    from scipy.optimize import brentq

    parts = there.by_effect
    each = sum(parts.values()) / sum(p > 0 for p in parts.values())
    factors = {e: float(np.sqrt(each / p)) if p > 0 else 0.0 for e, p in parts.items()}

    def beyond(times: float) -> float:
        tried = there.scaled({e: times * f for e, f in factors.items()})
        return mean_length(tried.covariance) - wanted

    # The same variance need not be the same mean, and is within a factor of 2.
    times = brentq(beyond, 0.0, 4.0)
    return {e: times * f for e, f in factors.items()}


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
    """What makes the tool's error, of a machine that a sheet calibrates or none.

    The error is linear in independent sources of unit variance: the errors of the parameters, each
    in its tolerance, and the noise of the readings. Without calibration it is ``S s z``, with S the
    shape of the TCP over the workspace by parameter and s the common scale of the tolerances. A
    calibration with the gain ``K = (s^-2 + W^T W)^-1 W^T`` of whitened readings ``W s z + n``
    leaves ``S (1 - K W) s z - S K n``. Variances of sources add, so each has its share.
    """

    slopes: Array  # TCP's shape by machine parameter in its tolerance (g, 3, P), metres
    effects: tuple[str, ...]  # of the parameters
    # whitened readings by these and by the dials' own (m, P + D); none without a calibration
    rows: Array | None

    @classmethod
    def of(cls, machine: Machine, sheet: Readings | None, noise: float | None) -> Sources:
        """Of a machine without errors; arguments as of ``needed_tolerances``."""
        catalogue, pitch = machine.catalogue, machine.spec.screw_pitch
        counted = [e for e in catalogue.values() if e.at_rest and (pitch or "pitch" not in e.needs)]
        names = [str(n) for e in counted for n in e.motions]
        rows = None
        if sheet is not None:
            # Parameters that it may show besides those that move the tool, and the dials' own.
            check_dials(machine.geometry)
            problem = foreseen(machine, sheet, noise)
            wide = with_everything(problem)
            of_dial = [n for n in wide.names if catalogue.effect_of(n).of_dial]
            shown = [str(n) for n in wide.names if n not in of_dial]
            names = list(dict.fromkeys([*names, *shown]))
            (exact,) = problem.campaigns
            rows = LinearReadings.of(machine, exact, [*names, *of_dial], noise).whitened()
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
