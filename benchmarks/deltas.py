"""What the tool says of real linear deltas, as a page: ``python -m benchmarks.deltas``.

The files are those of ``tests/data/delta``; nothing is simulated.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import orthoglide as og
from benchmarks import held_out, public

DATA = Path(__file__).parents[1] / "tests" / "data" / "delta"
STEPS_A_MM = 106.667
"""Of the 41 points, as their source says."""

COLUMNS = ("readings", "n", "base", "found", "verdict", "likeliest causes")
HEAD = """# Real printers

Read this page to see what the tool says of machines that nobody simulated: printers whose owners
published what their firmware stored (`tests/data/delta`, with sources). Printed by
`python -m benchmarks.deltas`.

## What was found

*Base* and *found* are residuals in mm rms: with endstops, radius, angles and arms fitted, and with
what the closed loop found. Of each cause stand the likeliest explanation with its probability, the
size of the credible set, and the probability that it is the plate's own shape.
"""
UNUSED = """
## Held against readings that were not used

One set of readings of a machine is used, and the machine found, with the shape of its plate,
predicts each of the others. Columns are ratios of root mean squares: closed loop to base, and to
the numbers that the firmware stored, which were fitted to some of these readings. *New numbers*:
predictions whose verdict advised some. *First* is the first cause with the number of its
alternatives, or the verdict. The files below v400-april were looked for after the methods were
made; only how rare a background wider than 0.1 tolerance is was settled with them in sight.
t1-mnemonic3d is the printer of t1-stock at another time. `python -m benchmarks.held_out` prints
every prediction, and takes folders of your own files.
"""


def forty_one_points() -> tuple[og.Readings, og.Machine]:
    """The 41 touches, through the stored numbers of a machine of that make, widely tolerated."""
    stock = og.import_printer(DATA / "t1-stock.cfg")
    firmware = public.firmware_of(stock)
    rows = list(csv.DictReader((DATA / "t1-41.csv").read_text().splitlines()))
    steps = np.array([[float(row[f"steps_{leg}"]) for leg in "abc"] for row in rows])
    zero = float(np.sqrt(stock.machine.geometry.L**2 - firmware.delta_radius**2))
    travel = np.round(firmware.at_endstop - steps * 1e-3 / STEPS_A_MM - zero, 12)
    n, like = len(rows), stock.campaigns[0]
    campaign = replace(
        like, name="t1-41", setup=np.zeros(n, dtype=np.int64), axis=np.zeros(n, dtype=np.int64),
        sign=np.ones(n), command=travel, second=np.full((n, 3), np.nan),
        approach=np.full((n, 3), -1.0), time=np.full(n, np.nan), temperature=np.full(n, np.nan),
        load=np.zeros(n), repeat=np.ones(n, dtype=np.int64), order=np.arange(1, n + 1),
        posture=tuple(row["point"] for row in rows), sigma=np.full(n, np.nan),
        reading=np.array([float(row["height_mm"]) * 1e-3 for row in rows]),
        line=np.arange(2, n + 2),
    )  # fmt: skip
    geometry = replace(stock.machine.geometry, stroke=(-0.17, 0.5))
    wide = {"joint_offset": 5e-3, "axis_offset": 4e-3, "leg_length": 1e-3}
    tolerance = {**stock.machine.tolerance, **wide}
    return campaign, og.Machine(
        replace(stock.machine, geometry=geometry, tolerance=tolerance, provenance={})
    )


def cases() -> Iterator[tuple[str, Sequence[og.Readings], og.Machine]]:
    """Name, readings and machine of every file, and of the 41 points."""
    for path in sorted(DATA.glob("*.cfg")):
        found = og.import_printer(path)
        yield path.stem, found.campaigns, og.Machine(found.machine)
    campaign, machine = forty_one_points()
    yield "t1-41", [campaign], machine


def told(name: str, campaigns: Sequence[og.Readings], verdict: og.Verdict) -> str:
    """A row of the table on one machine."""
    before, after = verdict.before.scores, verdict.after.scores
    causes = list[str]()
    for cause in verdict.effects:
        likeliest = cause.explanations[0]
        plate = sum(e.probability for e in cause.explanations if e.name.startswith("plate_"))
        causes.append(
            f"{likeliest.words} ({likeliest.probability:.2f}; of {len(cause.explanations)}, plate "
            f"{plate:.2f})"
        )
    cells = (
        name, str(sum(map(len, campaigns))), f"{before.rms * 1e3:.3f}", f"{after.rms * 1e3:.3f}",
        verdict.word, "; ".join(causes),
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def page() -> str:
    """The page."""
    lines = [HEAD, f"| {' | '.join(COLUMNS)} |", "|---|---:|---:|---:|---|---|"]
    for name, campaigns, machine in cases():
        lines.append(told(name, campaigns, og.close_loop(list(campaigns), machine)))
    lines += [UNUSED, *held_out.summary(held_out.every())]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    print(page(), end="")
