"""What the tool says of real linear deltas, as a page: ``python -m benchmarks.deltas``.

The files are those of ``tests/data/delta``; nothing is simulated.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import orthoglide as og
from benchmarks import held_out, public

DATA = Path(__file__).parents[1] / "tests" / "data" / "delta"
STEPS_A_MM = 106.667
"""Of the 41 points, as their source says."""

SIZES = dict.fromkeys(1e3 * size for size in public.sizes_of_plates())

MOST, IN_FULL = 3, "mesh-default_25Probe alone"
"""Members of a class that are listed, and the campaign of which all are."""

TO_TELL = "to tell the causes apart measure "
HEAD = """# Linear deltas

```
orthoglide import klipper printer.cfg --out DIR
orthoglide close-loop DIR/*.csv --machine DIR/machine.toml --out OUT
```

New numbers in a firmware's own words are given for Klipper only.

For a delta under RepRapFirmware, Marlin, Smoothieware or another firmware write a
[machine file](files.md#layout) with `kind = "linear-delta"` and the sizes that the firmware has,
let the firmware probe the plate, and import its list of touches:

```
orthoglide import plates heightmap.csv --machine machine.toml --out DIR
orthoglide close-loop DIR/*.csv --machine machine.toml --out OUT
```

| firmware | list of touches | `L` | `radius_mm` less `r` |
|---|---|---|---|
| RepRapFirmware | `heightmap.csv`, after `G29 S0` | `L` of `M665` | `R` of `M665` |
| Marlin | lines `Bed X: Y: Z:` of `G29` | `DELTA_DIAGONAL_ROD` | `DELTA_RADIUS` |
| Smoothieware | a table of x, y and z | `arm_length` | `arm_radius` |

A table may have its cells parted by commas, semicolons, tabs or blanks, and a first line that names
the columns with their units (`x_mm`, `Z [um]`); millimetres are taken where none is named. Each
probing of a log becomes a file of its own. Places that were not touched, a bare 0 of a height map
or no number, are left out, and so is what cannot be read, with a sentence that names its lines. A
height that all of a list have too much makes no difference; the places are taken as the nozzle's.
In Python it is `og.import_plates(path, machine_file)`. Without a list, touch the plate by a sheet
(`orthoglide design --owns plate --machine machine.toml --out plate.csv`): it says where to send the
tool, and asks for the height that the machine shows at the touch. The owner gets the verdict with
its causes, from `export` zeros of the three carriages and lengths of the arms, and compensated
commands; no values for `M665` and `M666`. A configuration file of these firmwares is not read, and
answered with what to write instead.

The importer of a `printer.cfg` reads what Klipper stores: its numbers, the heights and distances of
`[delta_calibrate]` with their step positions, and meshes, taken as probed with the numbers that
are stored now. A key, a height, a distance or a mesh that cannot be read is left out with one
sentence, and the rest is imported; positions that were stored with other microsteps are taken so.
It takes a `printer.cfg` or the folder that contains it, and reads what that includes from within
this folder. Where a key stands above the header of SAVE_CONFIG and below it, the one above counts,
as in the firmware, and both lines are reported. Heights that are all 0 where the probe hangs lower
than the nozzle are taken as `DELTA_CALIBRATE METHOD=manual` stores them, as touches of the nozzle
itself. What import says that matters to a result stands in `machine.toml`, and results repeat it.
What the firmware does not store (the platform's radius, the distance of an arm's rods, how far the
nozzle hangs below the joints) is taken as 32, 50 and 40 mm; the sizes of causes that turn the
platform depend on it. Correct them in `machine.toml`, the platform's radius `r` together with
`radius_mm`: their difference is the firmware's `delta_radius`, and another one is refused.

The report gives new numbers for the firmware beside the old ones, to paste and to undo. Its model
holds three endstops, one radius, three angles and three arms, and no other cause. Where the arms
that it has fitted differ from the rods by more than half a millimetre, the report begins with
that. Arms are taken as alike to 0.05 mm; of rods that were measured, give the sigma of the
measurement beside `leg_length` in `machine.toml`. Two lists of touches whose heights differ by more
than 0.2 mm where both touched are not of one plate and one set of numbers: they are named when they
are imported, and left out of the command that is proposed. A result that was made of them all the
same warns, and its numbers are not to be entered.

Where heights are off by the same everywhere, all endstops were moved together since
(`Z_OFFSET_APPLY_ENDSTOP`): z = 0 stays where it was set, and heights and meshes say the rest. The
probe's offset is taken as set in the middle of the plate with the stored numbers. Numbers are given
where the plate was touched out to a third of the towers' radius at least. Where distances were
read, arms are fitted to them as the firmware fits them, at the size that was read; by heights alone
arms stay the rods. Where that changes the arms by more than half a millimetre, the result asks to
measure a rod first: a print that shrank makes all distances shorter too.

The firmware's z = 0 is the plane of the heights of `DELTA_CALIBRATE` where they are read with a
mesh, else of all meshes alike. Beside the numbers stands what the firmware's own equations leave of
every file's heights and distances with the old and the new ones, and by that alone new ones are
offered: heights of one file at least are left smaller by a twentieth and by more than six fitted
numbers take by chance (12 in Akaike's criterion), and nothing of any file is left larger by a
twentieth. Where `DELTA_CALIBRATE` comes first they never are.

A probe sees one surface. The plate's height and slopes are fitted with every setup and go into the
endstops; what no polynomial of the fourth degree follows counts as noise of the touches, and a
single touch that is six times as far off is left out, and told. Many causes draw the same surface,
the bed's own shape among them: they are told as a class, each with its size. A level on the
platform, distances around the rim with both widths, the same by a longer tool
([`beside_z_mm`](files.md#readings-of-the-tool)), or a mesh with the plate turned by 60 degrees (a
profile of its own, imported with `--turned NAME=60`) decide between them, but none between all:
neither lobes of the bed nor paths of the carriages that all lean to one side turn the platform. A
result asks first for what most probably decides, as probable as each cause is, and says which it
tells apart, by how many sigma, and which not. [The truth table of the linear
delta](linear-delta-truth.md) has which instrument sees which cause, and how often the verdict is
right.

Up to the fourth degree a plate has more shapes than the bowl and three lobes that are named:
standard deviations of {sizes} mm are expected of those of the second, third and fourth
degree. No cause in the machine is named for what they may draw, however well distances fix the
towers. Where they are needed to explain what is left, the verdict is *partial* or *unexplained*,
and says that the plate may be behind it. The rms *with what was found* is past such shapes.

For a second visit, paste the numbers where the report says, `RESTART`, `BED_MESH_CALIBRATE`,
`SAVE_CONFIG`, and import into a new folder. Stored heights are steps and stay valid;
`DELTA_CALIBRATE` would put numbers of its own in the place of those pasted. Travel in an imported
file counts from the numbers that the firmware had; campaigns of other numbers do not go with it
and are refused.

What your instruments would find on a machine like yours can be tried before anything is measured:

```
orthoglide rehearse --machine DIR/machine.toml --owns plate,incline
```

## Real machines

Printed by `python -m benchmarks.deltas` from numbers that owners stored for their own machines
(`tests/data/delta`, with their sources). Nothing is simulated; probabilities stand in brackets.
"""


UNUSED = """
## Held against readings that were not used

Of each machine one set of readings is used alone, and the machine found predicts the others (root
mean squares in mm, printed by `python -m benchmarks.held_out`, which takes folders of your own
files). *Stored*: the firmware's numbers as they are, which were fitted to the heights and are
flattered by them; *base*: zeros, radius, angles and arms fitted again; *closed*: everything that
the closed loop found. The five files below v400-april were looked for after the methods were made;
only how rare a background wider than 0.1 tolerance is was settled with these readings in sight.
t1-mnemonic3d is the printer of t1-stock at another time.
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
    """All of every file, and what is asked for by itself."""
    for path in sorted(DATA.glob("*.cfg")):
        found = og.import_printer(path)
        machine = og.Machine(found.machine)
        yield path.stem, found.campaigns, machine
        meshes = [c for c in found.campaigns if c.name.startswith("mesh")]
        if len(meshes) > 1:
            for mesh in meshes:
                yield f"{path.stem}, {mesh.name} alone", [mesh], machine
            both = [c for c in found.campaigns if c not in meshes[:-1]]
            yield f"{path.stem}, {meshes[-1].name} with heights and distances", both, machine
    campaign, machine = forty_one_points()
    yield "t1-41", [campaign], machine


def told(name: str, campaigns: Sequence[og.Readings], verdict: og.Verdict) -> Iterator[str]:
    """A section on one machine."""
    before, after = verdict.before.scores, verdict.after.scores
    yield f"\n### {name}\n"
    yield (
        f"{sum(map(len, campaigns))} readings. Base: {before.rms * 1e3:.3f} mm rms. With what was "
        f"found: {after.rms * 1e3:.3f} mm. Verdict: **{verdict.word}**.\n"
    )
    if verdict.word == "unexplained":
        yield f"{public.claim_of(verdict)}\n"
    if verdict.effects:
        yield f"{certain(verdict)}\n"
    for cause in verdict.effects:
        yield "One of:" if len(cause.explanations) > 1 else "Found:"
        yield ""
        listed = cause.explanations[: None if name.endswith(IN_FULL) else MOST]
        for one in listed:
            yield f"- {one.words} ({one.probability:.2f})"
        if (more := len(cause.explanations) - len(listed)) > 0:
            yield f"- and {more} more"
        yield ""
    for suggestion in verdict.next_measurements[:1]:
        yield f"First of what would tell: {suggestion.reason.removeprefix(TO_TELL)}."


def certain(verdict: og.Verdict) -> str:
    """What is certain and what is not where causes are named."""
    classes = [c.explanations for c in verdict.effects]
    many = len(classes) > 1
    plate = [sum(e.probability for e in every if e.name.startswith("plate_")) for every in classes]
    return (
        f"Certain: endstops, radius, angles and arms do not explain these readings, and one cause "
        f"{'of each class ' * many}below is enough to. Not certain: which. The likeliest has "
        f"{_both(every[0].probability for every in classes)}, that it is the plate's own shape "
        f"{_both(plate)}{', class by class' * many}."
    )


def _both(numbers: Iterable[float]) -> str:
    return " and ".join(f"{one:.2f}" for one in numbers)


def page() -> str:
    """The page."""
    lines = [HEAD.format(sizes=", ".join(f"{size:g}" for size in SIZES))]
    for name, campaigns, machine in cases():
        lines += told(name, campaigns, og.close_loop(list(campaigns), machine))
    lines += [UNUSED, *held_out.table(held_out.every())]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    print(page(), end="")
