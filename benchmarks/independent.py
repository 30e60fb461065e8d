"""What readings can tell at all, computed from the tests' own machine without the package.

Columns are differences of `tests/rig.py` at one tolerance of the rig's machine file. Readings are
whitened by their noise, and what datums, dial placements, joint offsets and leg lengths explain is
projected out, each with its prior. From these follow the sizes of causes, the class of causes that
the readings cannot separate, and Gaussian oracles that are given the true scales.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests import rig_campaigns as rc
from tests.rig import LEGS, ON_DIAL, ON_LEG_AND_AXIS, Rig, parameter_names

Array = NDArray[np.float64]
Row = rc.Row

MACHINE_FILE = Path(__file__).parents[1] / "tests" / "data" / "rig" / "machine.toml"

FAMILIES = (
    "encoder_scale", "screw_error", "backlash", "drive_compliance", "axis_offset", "axis_tilt",
    "rail_tilt", "rail_bow", "mount_tilt", "bar_mismatch", "parallelogram_width",
    "thermal_growth", "thermal_drift", "gauge_direction", "gauge_scale", "gauge_drift",
)  # fmt: skip
"""Effects of the catalogue beside joint offsets and leg lengths."""

BASE_FAMILIES = ("joint_offset", "leg_length")
BASE = tuple(f"{family}.{leg}" for family in BASE_FAMILIES for leg in LEGS)

PER_UNIT = dict.fromkeys(
    ("joint_offset", "leg_length", "axis_offset", "rail_bow", "bar_mismatch", "screw_error",
     "parallelogram_width", "backlash", "gauge_drift", "drive_compliance"), 1e-3,
)  # fmt: skip
"""Units of files that hold a millimetre, SI; all others are 1."""

_DEFAULTS = {"drive_compliance": 1e-4, "thermal_growth": 5e-6, "thermal_drift": 1e-8}
"""Tolerances of the format, in the units of files, of effects that the machine file leaves out."""


def _tolerances() -> dict[str, float]:
    given = tomllib.loads(MACHINE_FILE.read_text(encoding="utf-8"))["tolerance"]
    return {f: v * PER_UNIT.get(f, 1.0) for f, v in {**_DEFAULTS, **given}.items()}


TOLERANCE = _tolerances()
"""Standard deviation to expect of each family by the rig's machine file, SI."""

NOISE = float(np.hypot(5e-6, 1e-5 / np.sqrt(12)))
"""Standard deviation of one reading: 5 um, and the rounding to 0.01 mm; metres."""

PLACEMENT = 1e-3  # standard deviation of a dial's place, metres
STEP = 0.01  # of a tolerance, for differences
VISIBLE = 0.3  # sigmas in all readings below which a parameter at its tolerance is not seen
SAME = 2.0
"""Sigmas within which two causes cannot be separated: a change of chi2 of 4."""


def family_of(name: str) -> str:
    """Return the effect that a parameter or a structured member belongs to."""
    return name.partition(".")[0]


def tolerance(name: str) -> float:
    """Return the tolerance of a parameter, SI."""
    return TOLERANCE[family_of(name)]


def parameters(family: str, setups: Sequence[str] = ()) -> list[str]:
    """Return the single parameters of a family."""
    return [n for n in parameter_names(setups) if family_of(n) == family]


def structured(family: str, setups: Sequence[str] = ()) -> dict[str, dict[str, float]]:
    """Return the structured members of a family with the weight of each parameter, as the file
    format defines them.
    """
    names = parameters(family, setups)
    if family in ON_LEG_AND_AXIS:
        turn = {"xy": 1.0, "yz": 1.0, "zx": 1.0}
        signs = {n: turn.get(n[-3] + n[-1], -1.0) for n in names}
        found = {f"{family}.common": dict.fromkeys(names, 1.0), f"{family}.cyclic": signs}
        for a, b in turn:
            one, other = f"{family}.{a}.{b}", f"{family}.{b}.{a}"
            found[f"{family}.{a}{b}.symmetric"] = {one: 1.0, other: 1.0}
            found[f"{family}.{a}{b}.antisymmetric"] = {one: 1.0, other: -1.0}
        return found
    if family in ("mount_tilt", "screw_error"):
        ends = dict.fromkeys(n.rpartition(".")[2] for n in names)
        return {
            f"{family}.{end}.common": {n: 1.0 for n in names if n.endswith(f".{end}")}
            for end in ends
        }
    return {f"{family}.common": dict.fromkeys(names, 1.0)} if len(names) > 1 else {}


def is_cause(
    name: str, parts: Sequence[str], cause: str, family: str, same: Sequence[str] = ()
) -> bool:
    """Whether a named cause is the true one: itself, a block of its family that contains it, or a
    member of its family that the readings cannot separate from it.
    """
    of_family = name == family or name.startswith(f"{family}.")
    block = of_family and len(parts) > 1 and (name == family or cause in parts)
    return name == cause or block or (of_family and name in same)


# -- readings of the rig -------------------------------------------------------------------------


class Sheet:
    """Rows of dial readings; predicts them with every posture solved once."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.rows = rows
        self.setups = list(dict.fromkeys(row["setup"] for row in rows))
        column = {k: np.array([float(row.get(k) or 0) for row in rows])
                  for k in ("time_s", "temperature_C", "load_N", "gauge_mm")}  # fmt: skip
        rho = np.array([[row[c] for c in rc.RHO] for row in rows]) * 1e-3
        self.time, self.gauge = column["time_s"], column["gauge_mm"] * 1e-3
        warming = column["temperature_C"] - column["temperature_C"][0]
        key = np.column_stack([rho, rc.approaches(rows), warming, column["load_N"]])
        self._posture, self._index = np.unique(key, axis=0, return_inverse=True)
        self._index = self._index.reshape(-1)
        self.setup = np.array([self.setups.index(row["setup"]) for row in rows])
        visit = np.column_stack([self.setup, key[:, :6], key[:, 7]])
        self.stations = len(np.unique(visit, axis=0))
        self.datums = (self.setup[:, None] == np.arange(len(self.setups))).astype(float)

    def predict(self, rig: Rig, gauge_error: Array | float = 0.0) -> Array:
        """Return the readings of a rig without extras, the datums left out ``(n,)``, metres."""
        if any(v for n, v in rig.errors.items() if n.startswith("thermal_drift")):
            return rc.predict(rig, self.rows, gauge_error)
        p = self._posture
        pose = rig.pose(p[:, :3], p[:, 3:6], 0.0, p[:, 6], p[:, 7])
        return rig.readings(
            pose.lines[self._index],
            [LEGS.index(row["leg"]) for row in self.rows],
            [row["direction"] for row in self.rows],
            self.gauge + gauge_error,
            [int(row.get("bar") or 0) for row in self.rows],
            [row["setup"] for row in self.rows],
            self.time,
        )

    def column(self, rig: Rig, value: Array, direction: Mapping[str, float]) -> Array:
        """Return what moving along a direction adds to the readings, to first order ``(n,)``."""
        moved = {n: rig.error(n) + STEP * v for n, v in direction.items()}
        return (self.predict(rig.with_errors(moved)) - value) / STEP

    def placements(self, rig: Rig, value: Array) -> Array:
        """Return what a dial's place off by its standard deviation shows ``(n, setups)``."""
        moved = self.predict(rig, STEP * PLACEMENT) - value
        return self.datums * moved[:, None] / STEP


class Whitener:
    """Whitens readings and projects out nuisances.

    Args:
        sigma: standard deviation of a reading, or of each.
        free: columns of nuisances without a prior ``(n, q)``.
        known: columns of nuisances at one standard deviation of their prior ``(n, k)``.
    """

    def __init__(self, sigma: Array | float, free: Array, known: Array) -> None:
        self.sigma = np.broadcast_to(np.asarray(sigma, dtype=float), len(free))
        self.count = known.shape[1]
        priors = np.hstack([np.zeros((self.count, free.shape[1])), np.eye(self.count)])
        white = np.hstack([free, known]) / self.sigma[:, None]
        self._basis = np.linalg.qr(np.vstack([white, priors]))[0]

    def past(self, readings: Array, priors: Array | None = None) -> Array:
        """Return readings ``(n, ...)`` whitened, past the nuisances ``(n + k, ...)``.

        Args:
            readings: metres, or the unit of ``sigma``.
            priors: residuals of the priors ``(k,)``; zero where absent.
        """
        below = np.zeros((self.count, *readings.shape[1:])) if priors is None else priors
        whole = np.concatenate([(readings.T / self.sigma).T, below])
        return np.asarray(whole - self._basis @ (self._basis.T @ whole))


@dataclass(frozen=True)
class Candidate:
    """A cause at its tolerance: its family, its parameters, and its whitened columns."""

    family: str
    parameters: tuple[str, ...]
    columns: Array


class Visible:
    """What every cause of the catalogue shows in a sheet's readings of a machine.

    Args:
        sheet: rows.
        rig: machine about which causes are linearised.
        known: further nuisances: parameters with the standard deviation of their prior, SI.
    """

    def __init__(self, sheet: Sheet, rig: Rig, known: Mapping[str, float] | None = None) -> None:
        self.sheet, self.rig, self.stations = sheet, rig, sheet.stations
        self.value = sheet.predict(rig)
        self._prior = {**{n: tolerance(n) for n in BASE}, **(known or {})}
        columns = [sheet.column(rig, self.value, {n: sd}) for n, sd in self._prior.items()]
        placed = sheet.placements(rig, self.value)
        known_columns = np.column_stack([*columns, placed])
        self.whitener = Whitener(NOISE, sheet.datums, known_columns)
        self._known = known_columns

    def past(self, readings: Array) -> Array:
        """Return readings whitened and past the nuisances."""
        return self.whitener.past(readings)

    def rms(self, shown: Array) -> float:
        """Return the root mean square over stations, in sigmas of a station's average."""
        return float(np.linalg.norm(shown) / np.sqrt(self.stations))

    def residual(self) -> Array:
        """Return what the nuisances leave of the sheet's readings, about the machine given."""
        reading = np.array([row["reading_mm"] for row in self.sheet.rows]) * 1e-3
        z = np.array([self.rig.error(n) / sd for n, sd in self._prior.items()])
        z = np.concatenate([z, np.zeros(self._known.shape[1] - len(z))])
        return self.past(reading - self.value + self._known @ z)

    @cached_property
    def columns(self) -> dict[str, Array]:
        """Whitened columns of the parameters that can be seen, at their tolerance."""
        names = [n for f in FAMILIES for n in parameters(f, self.sheet.setups)]
        found = {
            n: self.past(self.sheet.column(self.rig, self.value, {n: tolerance(n)})) for n in names
        }
        return {n: c for n, c in found.items() if np.linalg.norm(c) > VISIBLE}

    @cached_property
    def candidates(self) -> dict[str, Candidate]:
        """Single parameters, structured members, and both phases of each leg's screw."""
        return candidates_of(
            self.columns, {f: structured(f, self.sheet.setups) for f in FAMILIES}, "screw_error"
        )


def candidates_of(
    columns: Mapping[str, Array], members: Mapping[str, Mapping[str, Mapping[str, float]]],
    paired: str,
) -> dict[str, Candidate]:  # fmt: skip
    """Return the candidates that are made of visible parameters."""
    found = {n: Candidate(family_of(n), (n,), c[:, None]) for n, c in columns.items()}
    for family, each in members.items():
        for name, weights in each.items():
            if all(n in columns for n in weights):
                together = sum(w * columns[n] for n, w in weights.items())
                found[name] = Candidate(family, (name,), np.asarray(together)[:, None])
    waves: dict[str, list[str]] = {}
    for name in columns:
        if family_of(name) == paired:
            waves.setdefault(name.rpartition(".")[0], []).append(name)
    for leg, pair in waves.items():
        both = np.column_stack([columns[n] for n in pair])
        found[leg] = Candidate(paired, tuple(pair), both)
    return found


def metric(
    shown: Array,
    candidates: Mapping[str, Candidate],
    cause: tuple[str, str],
    size: int = 1,
    others: Array | None = None,
) -> dict[str, Any]:
    """Return the size of a cause past the base, its class, and the distance to the nearest other.

    Args:
        shown: what it adds to the readings, whitened and past the nuisances.
        candidates: of the same readings.
        cause: its name and family.
        size: number of its parameters; rivals have no more.
        others: whitened columns of what else is wrong.
    """
    known = others if others is not None and others.size else np.zeros((len(shown), 0))
    basis = np.linalg.qr(known)[0]

    def left(vectors: Array) -> Array:
        return np.asarray(vectors - basis @ (basis.T @ vectors))

    alone, distance = left(shown), dict[str, float]()
    for name, candidate in candidates.items():
        if name != cause[0] and candidate.columns.shape[1] <= size:
            space = np.linalg.qr(left(candidate.columns))[0]
            distance[name] = float(np.linalg.norm(alone - space @ (space.T @ alone)))
    same = [name for name, apart in distance.items() if apart <= SAME]
    rest = {name: apart for name, apart in distance.items() if apart > SAME}
    nearest = min(rest, key=rest.__getitem__, default="")
    norm = float(np.linalg.norm(alone))
    return {
        "name": cause[0], "family": cause[1], "norm": norm, "same": len(same),
        "same_family": [n for n in same if candidates[n].family == cause[1]],
        "nearest": nearest, "distance": rest.get(nearest, norm), "visible": cause[0] in candidates,
    }  # fmt: skip


# -- oracles -------------------------------------------------------------------------------------


def oracle(
    sheet: Sheet, scales: Mapping[str, Mapping[str, float]], rounds: int = 3
) -> dict[str, float]:
    """Return the posterior mean of a machine whose scales are given, SI.

    Args:
        sheet: rows with readings.
        scales: directions, each normal with standard deviation 1: parameters to their share, SI.
        rounds: of linearising about the mean.
    """
    reading = np.array([row["reading_mm"] for row in sheet.rows]) * 1e-3
    z = np.zeros(len(scales))
    for _ in range(rounds):
        rig = Rig(errors=_sum(scales, z))
        value = sheet.predict(rig)
        columns = np.column_stack([sheet.column(rig, value, d) for d in scales.values()])
        residual = reading - value + columns @ z
        both = np.column_stack([columns, sheet.placements(rig, value), residual]) / NOISE
        datum = sheet.datums / np.sqrt(sheet.datums.sum(axis=0))
        *A, r = (both - datum @ (datum.T @ both)).T
        A = np.transpose(A)
        z = np.linalg.solve(np.eye(A.shape[1]) + A.T @ A, A.T @ r)[: len(scales)]
    return _sum(scales, z)


def _sum(scales: Mapping[str, Mapping[str, float]], z: Array) -> dict[str, float]:
    found: dict[str, float] = {}
    for direction, size in zip(scales.values(), z.tolist(), strict=True):
        for name, value in direction.items():
            found[name] = found.get(name, 0.0) + size * value
    return found


def base_scales(offset: float | None = None, length: float | None = None) -> dict[str, Any]:
    """Return the scales of joint offsets and leg lengths, SI; the tolerances where absent."""
    sd = {"joint_offset": offset, "leg_length": length}
    return {n: {n: sd[family_of(n)] or tolerance(n)} for n in BASE}


def tcp_error(errors: Mapping[str, float], command: Array, p: Array) -> list[float]:
    """Return mean and largest distance of a rig's TCP from measured points after the best
    translation, millimetres.
    """
    dials = tuple(f"{f}." for f in ON_DIAL)
    rig = Rig(errors={n: v for n, v in errors.items() if not n.startswith(dials)})
    apart = rig.pose(command).p - p
    distance = 1e3 * np.linalg.norm(apart - apart.mean(axis=0), axis=1)
    return [float(distance.mean()), float(distance.max())]
