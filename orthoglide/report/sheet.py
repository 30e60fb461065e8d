"""A measuring sheet to print: one page for each mounting, with the rows of the CSV in order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from typing import Any

from orthoglide.machine import Machine
from orthoglide.machine_file import Controller
from orthoglide.observations import Readings, Setup
from orthoglide.observations.writing import Row, campaign_rows, command_columns
from orthoglide.pictures import dials
from orthoglide.report.page import render_template
from orthoglide.scene import drawing


def sheet_page(sheet: Readings, machine: Machine, file: str) -> str:
    """Return a measuring sheet as HTML, to be printed and filled in; ``file`` is the name of the
    CSV with the same rows.
    """
    return render_template(
        "sheet.html.j2",
        file=file,
        machine=machine.spec.title,
        axes=machine.geometry.leg_names,
        counted=command_convention(machine),
        readings=len(sheet),
        pages=list(_pages(sheet, machine)),
        pairs=any(len(s.gauges) > 1 for s in sheet.setups),
    )


def command_convention(machine: Machine) -> str:
    """Return how the commands of a sheet are counted, a sentence."""
    if machine.spec.controller != Controller():
        return "Positions are millimetres as the controller shows them."
    zero = f"{machine.geometry.L * 1e3:g}"
    return (
        f"Positions are joint coordinates in millimetres: {zero}, {zero}, {zero} is mechanical "
        "zero. With [controller] in the machine file they are what your controller shows."
    )


def dial_words(setup: Setup, machine: Machine, otherwise: str) -> tuple[str, ...]:
    """Return how to mount a dial, a sentence each: its place, the surface that it touches, and its
    direction; ``otherwise``: what to do if it counts the other way.
    """
    names, L = machine.geometry.leg_names, machine.geometry.L
    leg, axis = names[setup.leg], names[setup.axis]
    _, short_link = machine.geometry.layout.names.across[setup.leg]
    touched = {
        0: "the leg's median line, halfway between its two bars",
        1: f"bar 1, the one on the +{short_link} side",
        2: f"bar 2, the one on the −{short_link} side",
    }[setup.bar]
    counts = "+" if setup.sign > 0 else "−"
    places = " and ".join(f"{gauge * 1e3:.4g}" for gauge in setup.gauges)
    shares = " and ".join(f"{100 * gauge / L:.0f}" for gauge in setup.gauges)
    sentences = (
        f"On leg {leg}, against {touched}.",
        f"{places} mm from the leg's joints at the platform, to a millimetre, with the machine at "
        f"mechanical zero ({shares} % of the way to the carriage).",
        f"It reads along {axis}: its number must grow when the leg moves toward {counts}{axis}; "
        f"if it falls, {otherwise}.",
    )
    if len(setup.gauges) == 1:
        return sentences
    return (
        *sentences,
        f"Two dials, both set to zero against the surface that the leg should be parallel to, "
        f"across {axis}: write what the one at {setup.gauge2 * 1e3:.4g} mm shows less what the one "
        f"at {setup.gauge * 1e3:.4g} mm shows.",
    )


def _pages(sheet: Readings, machine: Machine) -> Iterator[dict[str, Any]]:
    """Yield the data of one page for each mounting."""
    rows = campaign_rows(sheet, machine.spec)
    commands = command_columns(rows[0])
    together = mounted_together(rows)
    by_name = {s.name: s for s in sheet.setups}
    posed = machine.with_only({}).posed()
    machine_dials = dials(posed, [sheet])
    numbered = enumerate(rows, start=2)
    for names, lines in groupby(numbered, key=lambda line: together[line[1]["setup"]]):
        page_dials = []
        for setup in (by_name[n] for n in names):
            reversed_setup = replace(setup, sign=-setup.sign)
            otherwise = f"write {reversed_setup.direction} in column direction"
            page_dials.append((setup.name, dial_words(setup, machine, otherwise)))
        title = " and ".join(names)
        shown_dials = [d for d in machine_dials if d.name in names]
        picture = drawing(posed, dials=shown_dials, title=f"Where to mount {title}")
        steps = list(_steps(list(lines), names, commands))
        yield {"title": title, "dials": page_dials, "steps": steps, "drawing": picture}


def mounted_together(rows: list[Row]) -> dict[str, tuple[str, ...]]:
    """Return by setup the names of the setups that are read at one visit, in their order."""
    commands = command_columns(rows[0])
    names_by_setup: dict[str, tuple[str, ...]] = {}
    for visit in _visits(rows, commands):
        names = tuple(dict.fromkeys(row["setup"] for row in visit))
        for name in names:
            names_by_setup[name] = max(names, names_by_setup.get(name, ()), key=len)
    return names_by_setup


def _visits(rows: list[Row], commands: list[str]) -> Iterator[list[Row]]:
    """Yield consecutive rows of one command, each setup at most once."""
    visit: list[Row] = []
    for row in rows:
        same_command = visit and [row[c] for c in commands] == [visit[0][c] for c in commands]
        unread = row["setup"] not in {r["setup"] for r in visit}
        if visit and not (same_command and unread and _is_move(row) == _is_move(visit[0])):
            yield visit
            visit = []
        visit.append(row)
    yield visit


def _is_move(row: Row) -> bool:
    return row.get("kind") == "move"


def _steps(
    lines: list[tuple[int, Row]], names: tuple[str, ...], commands: list[str]
) -> Iterator[dict[str, Any]]:
    """Yield the commands with their lines of the CSV and the dials that are read there."""
    numbers = iter(number for number, _ in lines)
    for visit in _visits([row for _, row in lines], commands):
        first = visit[0]
        read = {row["setup"] for row in visit}
        yield {
            "lines": [next(numbers) for _ in visit],
            "move": _is_move(first),
            "posture": first["posture"],
            "repeat": first["repeat"],
            "commands": [f"{float(first[c]):.3f}".rstrip("0").rstrip(".") for c in commands],
            "boxes": [name in read and not _is_move(first) for name in names],
        }
