"""The campaigns of the truth table: which faults are put into which machine, and what they show.

Everything is simulated by the tests' own machine (`tests/rig.py`); a case is drawn from the seed
and its own key alone, so that any one of them can be made again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from benchmarks import independent
from benchmarks.independent import FAMILIES, parameters, structured
from tests import rig_campaigns as rc
from tests.rig import LEGS, ON_DIAL, TOLERANCE, Rig, parameter_names

Array = NDArray[np.float64]

BACKGROUND = 0.015
"""Share of its tolerance in `tests/rig.py` that everything not put in on purpose has as an error.

Chosen by what it shows and not by what the tool says of it: past the base, the rms stays below half
a sigma of the averaged readings in 95 of 100 machines, on the protocol that shows it most.
"""

PLAIN = [f for f in FAMILIES if f not in ("thermal_growth", "drive_compliance")]
"""Effects that show at one temperature and without a load."""

PROTOCOLS = ("standard", "sweep", "two-gauges")
RMS = (1.0, 2.0, 4.0, 8.0, 20.0)
"""Sizes of single effects: rms of what they show past the base, in sigmas of averaged readings."""

LARGEST = 3.0
"""No effect is made larger than this, in tolerances of the machine file."""

LARGEST_OUTSIDE = 1e-3  # metres

OUTSIDE = ("s_curve", "wavy_rail", "kinked_rail", "drive_cubic", "drive_step", "stick_slip",
           "hysteresis", "growing_lash", "cross_coupling", "warming_drive", "carriage_roll",
           "carriage_yaw", "loosening_bar", "platform_play", "dial_curve", "warming_drives",
           "jumping_drive", "snapping_bar", "platform_travel", "twisting_carriage")  # fmt: skip
LATER = OUTSIDE[-5:]
"""Kinds that earlier versions were not asked about."""

JUMPS = ("jumping_drive", "snapping_bar")
"""Kinds after which the machine stays as it is."""

SWEEPS = ("sweep", "fine-sweep", "two-gauges")
FAULTS = ("outlier", "knocked_stand", "swapped_sign", "swapped_labels", "wrong_unit", "stuck_dial")
SHARES = {"nothing": 200, "effect": 240, "structured": 24, "pair": 60, "outside": 180, "fault": 60,
          "three": 60}  # fmt: skip
"""Campaigns of each kind in a full table."""

SHORT = ("bump", "short_wave", "rail_wave")
"""Kinds of errors that are short beside the distances of the stations: a table of their own."""

SHORT_SIZES = (0.05, 0.1, 0.2)  # millimetres
SHORT_SHEETS = ("sweep", "two-gauges")
BUMP_WIDTH = (0.006, 0.010)  # metres, standard deviation of the bell
BUMP_MISSES = 0.004  # metres by which its top lies off a station at most
WAVE_PERIOD = (0.006, 0.014)  # metres, of a drive: a turn of its screw
RAIL_PERIOD = (0.010, 0.045)  # metres: rollers, or a profile that was pressed

FIRST_SIZE = 1e-4
"""Metres: size at which something outside the catalogue is tried first."""


@dataclass(frozen=True)
class Case:
    """One campaign to simulate.

    Attributes:
        kind: nothing, effect, structured, pair, three, outside, fault, or one of `SHORT`.
        what: family, or kind of fault; families joined by + where there are several.
        protocol: of the readings.
        rms: wanted size, in sigmas of averaged readings; of short errors in millimetres.
        round: distinguishes cases that are otherwise alike.
    """

    kind: str
    what: str
    protocol: str
    rms: float
    round: int

    @property
    def key(self) -> str:
        """Name of the case, unique in a table."""
        return f"{self.kind}:{self.what}:{self.protocol}:{self.rms:g}:{self.round}"

    def rng(self, seed: int) -> np.random.Generator:
        """Draws of this case alone."""
        return np.random.default_rng([seed, crc32(self.key.encode())])


def cases(campaigns: int, only: str = "", short: int = 0) -> list[Case]:
    """Return the cases of a table with about that many campaigns, and so many of each short kind;
    a smaller table is part of a larger one.
    """
    total = sum(SHARES.values())
    counts = {kind: max(1, round(share * campaigns / total)) for kind, share in SHARES.items()}
    found: list[Case] = []
    for kind, count in (counts | dict.fromkeys(SHORT, short)).items():
        if not only or kind == only:
            source = _endless(kind)
            found += [next(source) for _ in range(count)]
    return found


def _endless(kind: str) -> Iterator[Case]:
    number = 0
    while True:
        batch = [Case(kind, what, p, rms, number) for what, p, rms in _grid(kind, number)]
        yield from sorted(batch, key=lambda c: crc32(c.key.encode()))
        number += 1


def _grid(kind: str, number: int) -> list[tuple[str, str, float]]:
    if kind == "nothing":
        return [("", p, 0.0) for p in PROTOCOLS]
    if kind == "effect":
        return [(f, p, rms) for f in FAMILIES for p in PROTOCOLS for rms in RMS]
    if kind == "structured":
        shaped = [f for f in FAMILIES if f not in ON_DIAL and structured(f)]
        return [(f, p, rms) for f in shaped for p in PROTOCOLS for rms in (5.0, 15.0)]
    if kind == "outside":
        return [(f, p, rms) for f in OUTSIDE for p in SWEEPS for rms in (6.0, 12.0)]
    if kind in SHORT:
        rails = ("rail.b", "rail.c")
        where = {"bump": (*rails, "drive"), "short_wave": ("drive",), "rail_wave": rails}[kind]
        sheets = SHORT_SHEETS if kind == "bump" else SWEEPS
        return [(w, p, mm) for w in where for p in sheets for mm in SHORT_SIZES]
    if kind == "fault":
        return [(f, p, 0.0) for f in FAULTS for p in PROTOCOLS]
    count, sizes = (3, (10.0, 30.0)) if kind == "three" else (2, (6.0, 15.0))
    rng = np.random.default_rng([crc32(kind.encode()), number])
    return [
        ("+".join(rng.choice(PLAIN, count, replace=False)), protocol, rms)
        for protocol in PROTOCOLS[1:]
        for rms in sizes
    ]


def rows_of(case: Case) -> list[rc.Row]:
    """Rows without readings; a temperature that rises and falls, or a weight put on and off."""
    rows = rc.protocol_rows(case.protocol)
    if case.what == "thermal_growth":
        end = rows[-1]["time_s"]
        for row in rows:
            warming = 8 * np.sin(2.2 * np.pi * row["time_s"] / end)
            row["temperature_C"] = round(float(22 + warming), 1)
    if case.what == "drive_compliance":
        both = [
            {**row, "time_s": row["time_s"] + wait, "load_N": load}
            for row in rows
            for wait, load in ((0.0, 0.0), (8.0, 100.0))
        ]
        both.sort(key=lambda row: row["time_s"])
        rows = [{**row, "order": k} for k, row in enumerate(both)]
    return rows


def base_errors(rng: np.random.Generator) -> dict[str, float]:
    """Joint offsets of about a millimetre and lengths of a few hundredths."""
    offsets = {f"joint_offset.{leg}": float(rng.normal(0, 1e-3)) for leg in LEGS}
    return offsets | {f"leg_length.{leg}": float(rng.normal(0, 5e-5)) for leg in LEGS}


def background(rng: np.random.Generator, setups: list[str], share: float) -> dict[str, float]:
    """Small errors of everything."""
    return {
        name: share * TOLERANCE[name.partition(".")[0]] * float(rng.standard_normal())
        for name in parameter_names(setups)
        if name.partition(".")[0] in TOLERANCE
    }


@dataclass(frozen=True)
class Cause:
    """What is put in on purpose: an effect of the catalogue, or something outside it.

    Attributes:
        name: as a candidate is called; the kind for what lies outside.
        family: the same of its family.
        errors: parameters at one tolerance, SI; empty outside.
        extra: a machine with it, from one without and a size; outside the catalogue only.
        places: where it is, as the tool calls places; outside the catalogue only.
        largest: size beyond which it is not asked for, in tolerances, or metres outside.
    """

    name: str
    family: str
    errors: Mapping[str, float]
    extra: Callable[[Any, float], Any] | None = None
    places: tuple[str, ...] = ()
    largest: float = LARGEST

    def added_to(self, rig: Any, size: float) -> Any:
        """The machine with this cause at a size (tolerances, or metres outside)."""
        if self.extra is not None:
            return self.extra(rig, size)
        errors = {n: rig.errors.get(n, 0.0) + size * value for n, value in self.errors.items()}
        return replace(rig, errors={**rig.errors, **errors})


def _of_rig(field: str, made: Callable[[float], Any]) -> Callable[[Rig, float], Rig]:
    """Return what adds to a field of a rig that has several errors of a kind."""

    def added(rig: Rig, size: float) -> Rig:
        there, more = getattr(rig, field), made(size)
        both = {**there, **more} if isinstance(more, dict) else (*there, more)
        return replace(rig, **{field: both})

    return added


def effect(
    family: str, rng: np.random.Generator, setups: Sequence[str] = (), shaped: bool = False
) -> Cause:
    """A member of a family, either sign, at one tolerance of the rig's machine file."""
    tolerance = independent.TOLERANCE[family]
    sign = float(rng.choice([-1.0, 1.0])) * tolerance
    if shaped:
        members = structured(family)
        name = str(rng.choice(sorted(members)))
        return Cause(name, family, {n: sign * w for n, w in members[name].items()})
    if family == "screw_error":
        leg, phase = str(rng.choice(list(LEGS))), float(rng.uniform(0, 2 * np.pi))
        waves = {"sin": np.cos(phase), "cos": np.sin(phase)}
        errors = {f"{family}.{leg}.{n}": tolerance * float(v) for n, v in waves.items()}
        return Cause(f"{family}.{leg}", family, errors)
    name = str(rng.choice(parameters(family, setups)))
    return Cause(name, family, {name: sign})


def outside(kind: str, rows: list[rc.Row], rng: np.random.Generator) -> Cause:
    """Something that no catalogue lists."""
    leg = int(rng.integers(3))
    across = int(rng.choice([j for j in range(3) if j != leg]))
    period, at = float(rng.uniform(0.035, 0.07)), float(rng.uniform(-0.07, 0.03))
    bar, own, other = int(rng.integers(2)), LEGS[leg], LEGS[across]
    setup = str(rng.choice(sorted({row["setup"] for row in rows if row["leg"] == own})))
    times = [row["time_s"] for row in rows if row["leg"] == own]
    began = float(rng.uniform(times[0], (times[0] + times[-1]) / 2))
    ended = (began + times[-1]) / 2
    every = [row["time_s"] for row in rows]
    # Drawn already, so that the other kinds stay as they were.
    jumped = float(np.quantile(every, 0.2 + 0.6 * (period - 0.035) / 0.035))
    rail, drive = f"rail.{own}.{other}/travel", f"drive.{own}"
    made: dict[str, tuple[str, Callable[[float], Any], str]] = {
        "s_curve": (rail, lambda v: rc.s_curve(leg, across, v), "extra"),
        "wavy_rail": (rail, lambda v: rc.wavy_rail(leg, across, v, period), "extra"),
        "kinked_rail": (rail, lambda v: rc.kinked_rail(leg, across, v, at), "extra"),
        "drive_cubic": (f"{drive}/travel", lambda v: rc.s_curve(leg, leg, v), "extra"),
        "drive_step": (f"{drive}/travel", lambda v: rc.drive_step(leg, v, at), "extra"),
        "stick_slip": (f"{drive}/travel", lambda v: rc.stick_slip(leg, v), "extra"),
        "hysteresis": (f"{drive}/reversal", lambda v: rc.hysteresis(leg, v), "extra"),
        "growing_lash": (f"{drive}/approach", lambda v: rc.growing_lash(leg, v), "extra"),
        "cross_coupling": (f"{drive}/command.{other}",
                           lambda v: rc.cross_coupling(leg, across, v * 10), "extra"),
        "warming_drive": (f"{drive}/time", lambda v: rc.warming_drive(leg, v), "extra"),
        "carriage_roll": (f"carriage.{own}.{own}/travel",
                          lambda v: rc.turning_carriage(leg, leg, v), "extra_turn"),
        "carriage_yaw": (f"carriage.{own}.{other}/travel",
                         lambda v: rc.turning_carriage(leg, across, v), "extra_turn"),
        "loosening_bar": (f"bar.{own}.{bar + 1}/time",
                          lambda v: rc.loosening_bar(leg, bar, v, began, ended),
                          "extra_length"),
        "platform_play": (f"platform.{own}.{other}/approach",
                          lambda v: rc.platform_play(leg, across, v), "extra_platform"),
        "warming_drives": ("drive/time", rc.warming_drives, "extra"),
        "jumping_drive": (f"{drive}/time", lambda v: rc.jumping_drive(leg, v, jumped), "extra"),
        "snapping_bar": (f"bar.{own}.{bar + 1}/time",
                         lambda v: rc.snapping_bar(leg, bar, v, began), "extra_length"),
        "platform_travel": (f"platform.{own}.{other}/travel",
                            lambda v: rc.platform_travel(leg, across, v), "extra_platform"),
        "twisting_carriage": (f"carriage.{own}.{other}/travel",
                              lambda v: rc.twisting_carriage(leg, across, v), "extra_turn"),
        "dial_curve": (f"dial.{setup}/reading", lambda v: {setup: rc.dial_curve(v)}, "extra_dial"),
    }  # fmt: skip
    place, extra, into = made[kind]
    # Its sawtooth comes later by the side of approach: one of travel, and lost motion.
    also = (f"{drive}/approach",) if kind == "stick_slip" else ()
    # A worn dial is wrong by three times its standard's limit (DIN 878: 17 um).
    largest = 5e-5 if into == "extra_dial" else LARGEST_OUTSIDE
    return Cause(kind, kind, {}, _of_rig(into, extra), (*_by_travel(place), *also), largest)


def _by_travel(place: str) -> tuple[str, ...]:
    """A place; one of a function of travel also where the function is told as short waves.

    A step of a drive and a sawtooth have both slow and fast parts, so either kernel may fit.
    """
    return tuple(dict.fromkeys((place, place.replace("/travel", "/waves"))))


def short_error(case: Case, rows: list[rc.Row], rng: np.random.Generator) -> tuple[Cause, float]:
    """A bump or a wave that is shorter than the distance of the stations, and its size, metres."""
    leg, size = int(rng.integers(3)), case.rms * 1e-3 * float(rng.choice([-1.0, 1.0]))
    own, drive = LEGS[leg], f"drive.{LEGS[leg]}"
    if case.kind == "short_wave":
        period, phase = float(rng.uniform(*WAVE_PERIOD)), float(rng.uniform(0, 2 * np.pi))
        wave = _of_rig("extra", lambda v: rc.drive_wave(leg, v, period, phase))
        return Cause(case.kind, case.kind, {}, wave, _by_travel(f"{drive}/travel")), size
    along = case.what == "drive"
    axis = leg if along else (leg + 1 + (case.what == "rail.c")) % 3
    places = _by_travel((drive if along else f"rail.{own}.{LEGS[axis]}") + "/travel")
    if case.kind == "rail_wave":
        period = float(rng.uniform(*RAIL_PERIOD))
        wave = _of_rig("extra", lambda v: rc.wavy_rail(leg, axis, v, period))
        return Cause(case.kind, case.kind, {}, wave, places), size
    # A drive shows in the readings on the other legs, a rail in those on its own.
    own_rows = [row for row in rows if (row["leg"] == own) != along]
    travel = sorted({row[rc.RHO[leg]] * 1e-3 - Rig().L for row in own_rows})
    at = float(rng.choice(travel)) + float(rng.uniform(-BUMP_MISSES, BUMP_MISSES))
    width = float(rng.uniform(*BUMP_WIDTH))
    bump = _of_rig("extra", lambda v: rc.bump(leg, axis, v, at, width))
    return Cause(case.kind, case.kind, {}, bump, places), size


def spoil(kind: str, rows: list[rc.Row], rng: np.random.Generator) -> rc.Fault:
    """A fault of the data."""
    setups = list(dict.fromkeys(row["setup"] for row in rows))
    one, other = map(str, rng.choice(setups, 2, replace=False))
    size = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.08, 0.4))
    after = float(rng.uniform(0.3, 0.7))
    if kind == "outlier":
        return rc.outlier(rows, int(rng.integers(len(rows))), size)
    if kind == "knocked_stand":
        return rc.knocked_stand(rows, one, size, after)
    if kind == "swapped_sign":
        return rc.swapped_sign(rows, one)
    if kind == "swapped_labels":
        return rc.swapped_labels(rows, one, other)
    if kind == "wrong_unit":
        return rc.wrong_unit(rows, one, float(rng.choice([1e-3, 1 / 25.4])))
    return rc.stuck_dial(rows, one, after)
