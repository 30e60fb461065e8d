"""Campaigns of the independent machine: protocols, dial readings, faults, what no catalogue lists.

Rows are dicts with the columns of the campaign files (mm there, SI everywhere else).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.rig import LEGS, Array, Extra, Rig

Row = dict[str, Any]
RHO = ("rho_x_mm", "rho_y_mm", "rho_z_mm")
APPROACH = ("approach_x", "approach_y", "approach_z")

ZERO_MAX_MIN = (("zero", 0.0), ("max", 60.0), ("min", -100.0))
THERE_AND_BACK = (0, 20, 40, 60, 40, 20, 0, -25, -50, -75, -100, -75, -50, -25)
SWEEP = tuple((f"{mm:+d}", float(mm)) for mm in THERE_AND_BACK)
FINE = (*range(0, 61, 10), *range(50, -101, -10), *range(-90, 0, 10))
FINE_SWEEP = tuple((f"{mm:+d}", float(mm)) for mm in FINE)
PROTOCOLS: dict[str, tuple[Sequence[tuple[str, float]], Sequence[float]]] = {
    "standard": (ZERO_MAX_MIN, (0.5,)),
    "sweep": (SWEEP, (0.5,)),
    "fine-sweep": (FINE_SWEEP, (0.5,)),
    "two-gauges": (SWEEP, (0.35, 0.65)),
}
"""Name to (postures: label and TCP travel along the leg in mm; dial places as parts of L)."""


# -- protocols and conditions ------------------------------------------------------------------


def protocol_rows(name: str, rig: Rig | None = None, repeats: int = 3) -> list[Row]:
    """Rows of a protocol without their readings.

    Two dials stand on one leg, for both lateral directions, and are read one after the other at
    every posture. A posture takes 20 s, mounting the dials elsewhere 600 s.
    """
    postures, places = PROTOCOLS[name]
    L = (rig or Rig()).L * 1e3
    rows: list[Row] = []
    clock = 0.0
    for leg, letter in enumerate(LEGS):
        for place in places:
            for repeat in range(1, repeats + 1):
                for label, travel in postures:
                    rho = [round(float(np.sqrt(L**2 - travel**2)), 6)] * 3
                    rho[leg] = round(L + travel, 6)
                    for direction in LEGS.replace(letter, ""):
                        rows.append(
                            {"setup": f"{letter}{direction}-{place:g}", "leg": letter}
                            | {"direction": direction, "posture": label}
                            | dict(zip(RHO, rho, strict=True))
                            | {"gauge_mm": round(place * L, 6), "repeat": repeat}
                            | {"order": len(rows), "time_s": clock}
                        )
                    clock += 20.0
            clock += 580.0
    return rows


def approaches(rows: Sequence[Row]) -> Array:
    """Direction of each axis' last move ``(N, 3)``: the columns, or derived from ``order``.

    An axis that does not move keeps its direction; the first posture counts as reached in +.
    """
    if all(column in rows[0] for column in APPROACH):
        return np.array([[float(row[c] or 0) for c in APPROACH] for row in rows])
    order = _order(rows)
    moves = np.sign(np.diff([[row[c] for c in RHO] for row in (rows[i] for i in order)], axis=0))
    near = np.ones((len(rows), 3))
    for k, move in enumerate(moves):
        near[order[k + 1]] = np.where(move == 0, near[order[k]], move)
    return near


def _order(rows: Sequence[Row]) -> NDArray[np.intp]:
    return np.argsort([row.get("order", k) for k, row in enumerate(rows)], kind="stable")


def _column(rows: Sequence[Row], name: str) -> Array:
    return np.array([float(row.get(name) or 0) for row in rows])


def predict(rig: Rig, rows: Sequence[Row], gauge_error: Array | float = 0.0) -> Array:
    """Readings ``(N,)`` in metres without datum, noise or rounding; extras see them in order."""
    order = _order(rows)
    done = [rows[i] for i in order]
    rho = np.array([[row[c] for c in RHO] for row in done]) * 1e-3
    time, temperature = _column(done, "time_s"), _column(rows, "temperature_C")
    pose = rig.pose(
        rho,
        approaches(rows)[order],
        time,
        (temperature - temperature[0])[order],
        _column(done, "load_N"),
    )
    readings = np.empty(len(rows))
    readings[order] = rig.readings(
        pose.lines,
        [LEGS.index(row["leg"]) for row in done],
        [row["direction"] for row in done],
        _column(done, "gauge_mm") * 1e-3 + np.broadcast_to(gauge_error, len(rows))[order],
        [int(row.get("bar") or 0) for row in done],
        [row["setup"] for row in done],
        time,
    )
    return readings


def simulate(
    rig: Rig,
    protocol: str | Sequence[Row],
    rng: np.random.Generator,
    *,
    noise: float = 5e-6,
    resolution: float = 1e-5,
    placement: float = 1e-3,
    background: float = 0.0,
    temperature: Callable[[Array], Array] | None = None,
    load: float | None = None,
) -> list[Row]:
    """Measure a machine.

    Args:
        rig: the machine.
        protocol: name of a protocol, or rows without readings.
        rng: of noise, datums, placement and background.
        noise: standard deviation of one reading, metres.
        resolution: of the dial, metres; 0 for none.
        placement: standard deviation of a dial's place against the stated one, once a setup.
        background: share of its tolerance that everything not set in the rig has as an error;
            where the TCP of that same machine is needed, call ``with_background`` yourself.
        temperature: degrees Celsius at the times given; its column is then written.
        load: newtons at the TCP; its column is then written.

    Returns:
        Rows with ``reading_mm``.
    """
    rows = protocol_rows(protocol, rig) if isinstance(protocol, str) else [*map(dict, protocol)]
    setups = list(dict.fromkeys(row["setup"] for row in rows))
    if background:
        rig = rig.with_background(rng, background, setups)
    if temperature is not None:
        for row, value in zip(rows, temperature(_column(rows, "time_s")), strict=True):
            row["temperature_C"] = round(float(value), 2)
    if load is not None:
        for row in rows:
            row["load_N"] = load
    of = [setups.index(row["setup"]) for row in rows]
    datum = rng.uniform(0, 1e-2, len(setups))[of]
    misplaced = rng.normal(0, placement, len(setups))[of]
    readings = predict(rig, rows, misplaced)
    # The dial is set by hand to somewhere in its range at the setup's first row.
    first = np.array([of.index(k) for k in range(len(setups))])[of]
    readings += datum - readings[first] + rng.normal(0, noise, len(rows))
    if resolution:
        readings = np.round(readings / resolution) * resolution
    for row, reading in zip(rows, readings, strict=True):
        row["reading_mm"] = round(float(reading) * 1e3, 6)
    return rows


def tcp_points(
    rig: Rig, n: int, rng: np.random.Generator, load: float = 0.0, time: float = 0.0
) -> list[Row]:
    """What a perfect tracker says of the TCP at n points of the cube the nominal machine covers.

    Commands lie within the stroke; approach is unknown: the middle of the dead band. All is
    measured at one second, by default before anything has changed with time.
    """
    low, high = 0.75 * rig.stroke[0], 0.9 * rig.stroke[1]
    wanted = rng.uniform(low, high, (n, 3))
    across = np.sum(wanted**2, axis=1, keepdims=True) - wanted**2
    rho = np.round((wanted + np.sqrt(rig.L**2 - across)) * 1e3, 6)
    p = np.round(rig.pose(rho * 1e-3, load=load, time=time).p * 1e3, 6)
    names = (*RHO, "p_x_mm", "p_y_mm", "p_z_mm")
    return [dict(zip(names, map(float, row), strict=True)) for row in np.hstack([rho, p])]


def write_csv(rows: Sequence[Row], path: str | Path) -> None:
    """Write rows in the order of their columns."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def read_csv(path: str | Path) -> list[Row]:
    """Rows of a campaign or TCP file, numbers as numbers."""
    text = {"kind", "setup", "leg", "direction", "posture", "bar"}
    whole = {"repeat", "order"}
    with open(path, newline="", encoding="utf-8") as file:
        return [
            {
                k: v if k in text or v == "" else (int if k in whole else float)(v)
                for k, v in row.items()
            }
            for row in csv.DictReader(file)
        ]


# -- effects outside the catalogue ---------------------------------------------------------------


def _moved(
    leg: int, axis: int, size: Callable[[Array, Array, Array], ArrayLike], by: int = -1, of: int = 3
) -> Extra:
    """Displace one leg along one base axis.

    ``size(travel, approach, time)`` takes the leg's travel and approach ``(N,)``, or those of the
    drive ``by``. With ``of`` = 2 the axis is a bar, for ``extra_length``.
    """
    drive = leg if by < 0 else by

    def effect(travel: Array, approach: Array, time: Array) -> Array:
        out = np.zeros((len(travel), 3, of))
        out[:, leg, axis] = size(travel[:, drive], approach[:, drive], time)
        return out

    return effect


def s_curve(leg: int, axis: int, value: float, stroke: tuple[float, float] = (-0.1, 0.06)) -> Extra:
    """A rail bent like an S: value x (u^3 - u), scaled so that value is the largest deviation."""
    middle, half = (stroke[0] + stroke[1]) / 2, (stroke[1] - stroke[0]) / 2

    def bend(s: Array, near: Array, time: Array) -> Array:
        u = (s - middle) / half
        return np.asarray(value * 1.5 * np.sqrt(3) * (u**3 - u))

    return _moved(leg, axis, bend)


def wavy_rail(leg: int, axis: int, value: float, period: float = 0.05) -> Extra:
    """A rail with waves: value x sin(2 pi travel / period), across the path."""
    return _moved(leg, axis, lambda s, near, time: value * np.sin(2 * np.pi * s / period))


def kinked_rail(leg: int, axis: int, value: float, at: float = -0.02) -> Extra:
    """A rail of two straight pieces that meet at a travel, value the deviation 50 mm from there."""
    return _moved(leg, axis, lambda s, near, time: value * np.abs(s - at) / 0.05)


def bump(leg: int, axis: int, value: float, at: float, width: float = 0.008) -> Extra:
    """A bump of a rail or a drive: value x exp(-(travel - at)^2 / (2 width^2)) along an axis."""
    return _moved(leg, axis, lambda s, near, time: value * np.exp(-(((s - at) / width) ** 2) / 2))


def drive_wave(leg: int, value: float, period: float, phase: float = 0.0) -> Extra:
    """A drive with waves: value x sin(2 pi travel / period + phase), along its axis."""
    return _moved(leg, leg, lambda s, near, time: value * np.sin(2 * np.pi * s / period + phase))


def drive_step(leg: int, value: float, at: float = 0.0) -> Extra:
    """A drive that jumps by value along its axis where its travel passes a place."""
    return _moved(leg, leg, lambda s, near, time: value * (s > at))


def growing_lash(leg: int, value: float, stroke: tuple[float, float] = (-0.1, 0.06)) -> Extra:
    """Lost motion that grows along the travel, from nothing to value."""
    low, high = stroke
    return _moved(leg, leg, lambda s, near, time: -value / 2 * near * ((s - low) / (high - low)))


def turning_carriage(leg: int, axis: int, value: float, period: float = 0.12) -> Extra:
    """For ``extra_turn``: the carriage turns by value / 0.04 m x sin(2 pi travel / period)."""
    return wavy_rail(leg, axis, value / 0.04, period)


def loosening_bar(leg: int, bar: int, value: float, begin: float, end: float) -> Extra:
    """For ``extra_length``: a bar grows by value between two times, faster and faster."""

    def longer(s: Array, near: Array, time: Array) -> Array:
        return np.asarray(value * np.clip((time - begin) / (end - begin), 0, 1) ** 2)

    return _moved(leg, bar, longer, of=2)


def dial_curve(value: float, period: float = 1.0e-3) -> Callable[[Array], Array]:
    """For ``extra_dial``: value x sin(2 pi reading / period)."""
    return lambda reading: value * np.sin(2 * np.pi * reading / period)


def dial_reversal(value: float) -> Callable[[Array], Array]:
    """For ``extra_dial``: the hand lags behind its plunger, by value between the two ways.

    Readings come in the order in which they were taken; before it first moved the plunger came
    from below.
    """

    def lag(reading: Array) -> Array:
        side, shown = 1.0, np.zeros(len(reading))
        for k in range(len(reading)):
            if k and abs(reading[k] - reading[k - 1]) > 1e-7:
                side = np.sign(reading[k] - reading[k - 1])
            shown[k] = -side * value / 2
        return shown

    return lag


def stick_slip(leg: int, value: float, step: float = 0.013) -> Extra:
    """The carriage sticks and jumps: it lags by a sawtooth of its travel, up to value.

    Where no approach is known: the mean of both sides.
    """

    def lag(s: Array, side: float) -> Array:
        way = side * s / step
        return np.asarray(-value * side * (way - np.floor(way)))

    def both(s: Array, near: Array, time: Array) -> Array:
        return ((1 + near) * lag(s, 1.0) + (1 - near) * lag(s, -1.0)) / 2

    return _moved(leg, leg, both)


def hysteresis(leg: int, value: float, length: float = 0.03) -> Extra:
    """Lost motion that builds up over a length after each reversal, to value at most.

    Rows are taken in the order given. Where no approach is known: the middle of the band.
    """

    def lag(s: Array, near: Array, time: Array) -> Array:
        goal = -value / 2 * near
        behind = goal.copy()
        for k in range(1, len(s)):
            decay = np.exp(-abs(s[k] - s[k - 1]) / length)
            behind[k] = goal[k] + (behind[k - 1] - goal[k]) * decay
        return behind

    return _moved(leg, leg, lag)


def cross_coupling(leg: int, by: int, value: float) -> Extra:
    """Drive ``leg`` moves along by value x travel of drive ``by``."""
    return _moved(leg, leg, lambda s, near, time: value * s, by)


def warming_drive(leg: int, value: float, time_constant: float = 1200.0) -> Extra:
    """One carriage drifts along its axis: value x (1 - exp(-t / time constant))."""
    return _moved(leg, leg, lambda s, near, time: value * (1 - np.exp(-time / time_constant)))


def warming_drives(value: float, time_constant: float = 1200.0) -> Extra:
    """All carriages drift along their axes alike: value x (1 - exp(-t / time constant))."""
    each = [warming_drive(leg, value, time_constant) for leg in range(3)]
    return lambda *conditions: np.sum([drive(*conditions) for drive in each], axis=0)


def jumping_drive(leg: int, value: float, at: float) -> Extra:
    """One carriage stands elsewhere by value from some second on: steps were lost once."""
    return _moved(leg, leg, lambda s, near, time: value * (time > at))


def snapping_bar(leg: int, bar: int, value: float, at: float) -> Extra:
    """For ``extra_length``: a bar is longer by value from some second on."""
    return _moved(leg, bar, lambda s, near, time: value * (time > at), of=2)


def platform_travel(leg: int, axis: int, value: float, period: float = 0.12) -> Extra:
    """For ``extra_platform``: value x sin(2 pi travel / period)."""
    return wavy_rail(leg, axis, value, period)


def twisting_carriage(leg: int, axis: int, value: float) -> Extra:
    """For ``extra_turn``: the carriage turns by value / 0.01 m x travel / 0.08 m."""
    return _moved(leg, axis, lambda s, near, time: value / 0.01 * s / 0.08)


def platform_play(leg: int, axis: int, value: float) -> Extra:
    """For ``extra_platform``: the leg's attachment lags half of value behind its axis' moves."""
    return _moved(leg, axis, lambda s, near, time: -value / 2 * near)


# -- faults of the data --------------------------------------------------------------------------


class Fault(NamedTuple):
    """Spoilt rows, and the indices of those that were touched."""

    rows: list[Row]
    touched: list[int]


def _changed(
    rows: Sequence[Row], touched: list[int], change: Callable[[Row], Mapping[str, Any]]
) -> Fault:
    chosen = set(touched)
    return Fault(
        [{**r, **change(r)} if k in chosen else dict(r) for k, r in enumerate(rows)], touched
    )


def _of(rows: Sequence[Row], *setups: str, after: float = 0.0) -> list[int]:
    """Rows of the setups, from the given share of them on."""
    found = [k for k, row in enumerate(rows) if row["setup"] in setups]
    return found[round(after * len(found)) :]


def outlier(rows: Sequence[Row], index: int, size_mm: float) -> Fault:
    """One reading misread by size_mm."""
    return _changed(rows, [index], lambda r: {"reading_mm": round(r["reading_mm"] + size_mm, 6)})


def knocked_stand(rows: Sequence[Row], setup: str, step_mm: float, after: float = 0.5) -> Fault:
    """The datum of a setup jumps by step_mm after that share of its rows."""
    touched = _of(rows, setup, after=after)
    return _changed(rows, touched, lambda r: {"reading_mm": round(r["reading_mm"] + step_mm, 6)})


def swapped_sign(rows: Sequence[Row], setup: str) -> Fault:
    """The dial of a setup counted the other way than its direction says."""
    return _changed(rows, _of(rows, setup), lambda r: {"reading_mm": -r["reading_mm"]})


def swapped_labels(rows: Sequence[Row], one: str, other: str) -> Fault:
    """Two setups carry each other's name, leg, direction and dial place."""
    keys = ("setup", "leg", "direction", "gauge_mm")
    label = {s: {k: rows[_of(rows, s)[0]][k] for k in keys} for s in (one, other)}
    other_of = {one: label[other], other: label[one]}
    return _changed(rows, _of(rows, one, other), lambda r: other_of[r["setup"]])


def wrong_label(rows: Sequence[Row], setup: str, column: str) -> Fault:
    """A setup carries the leg, or the direction, that it does not have in its other column."""
    first = rows[_of(rows, setup)[0]]
    taken = {str(first[c]).strip("-+") for c in ("leg", "direction")}
    (wrong,) = set(LEGS) - taken
    return _changed(rows, _of(rows, setup), lambda r: {column: wrong})


def wrong_command(rows: Sequence[Row], posture_index: int, drive: int, mm: float) -> Fault:
    """The command of one posture of one leg is written for one drive mm more than it was."""
    keys = [(row["leg"], *(row[c] for c in RHO)) for row in rows]
    chosen = list(dict.fromkeys(keys))[posture_index]
    touched = [k for k, key in enumerate(keys) if key == chosen]
    return _changed(rows, touched, lambda r: {RHO[drive]: round(r[RHO[drive]] + mm, 6)})


def wrong_unit(rows: Sequence[Row], setup: str, factor: float = 1e-3) -> Fault:
    """Readings of a setup in another unit: 1e-3 for metres, 1 / 25.4 for inches."""
    return _changed(rows, _of(rows, setup), lambda r: {"reading_mm": r["reading_mm"] * factor})


def whole_turns(rows: Sequence[Row], setup: str, turn_mm: float) -> Fault:
    """Of a setup only the large hand was read, which shows turn_mm by each turn."""

    own = _of(rows, setup)
    turns = [rows[k]["reading_mm"] // turn_mm for k in own]
    usual = max(turns, key=turns.count)  # the datum of the others is free
    spoilt = _changed(rows, own, lambda r: {"reading_mm": round(r["reading_mm"] % turn_mm, 6)})
    return Fault(spoilt.rows, [k for k, turn in zip(own, turns, strict=True) if turn != usual])


def stuck_dial(rows: Sequence[Row], setup: str, after: float = 0.5) -> Fault:
    """The dial of a setup keeps its value after that share of its rows."""
    touched = _of(rows, setup, after=after)
    value = rows[touched[0]]["reading_mm"]
    return _changed(rows, touched, lambda r: {"reading_mm": value})


def shifted_rows(rows: Sequence[Row], setup: str, by: int) -> Fault:
    """Readings of a setup a row too late, the first written twice; or too early, the last twice."""
    touched = _of(rows, setup)
    read = [rows[k]["reading_mm"] for k in touched]
    written = [read[0], *read[:-1]] if by > 0 else [*read[1:], read[-1]]
    found = [dict(row) for row in rows]
    for k, reading in zip(touched, written, strict=True):
        found[k]["reading_mm"] = reading
    return Fault(found, touched)


def swapped_commands(rows: Sequence[Row], one: int, other: int) -> Fault:
    """The commands of two drives stand in each other's columns."""
    a, b = RHO[one], RHO[other]
    return _changed(rows, list(range(len(rows))), lambda r: {a: r[b], b: r[a]})
