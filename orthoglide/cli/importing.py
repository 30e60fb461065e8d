"""``import``: machine file and readings from what a firmware stored."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

import orthoglide.cli.options as opt
from orthoglide.cli.run import Listed
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_results
from orthoglide.errors import InputError

if TYPE_CHECKING:
    from orthoglide.firmware.imported import Imported

_TURN = 360.0  # degrees


@click.group("import", cls=Listed)
def import_() -> None:
    """Machine file and readings from what a firmware stored."""


@import_.command()
@click.argument("config", type=opt.PATH)
@opt.out(help="Folder for machine.toml and the campaigns; must be new or empty.")
@click.option(
    "--turned", multiple=True, metavar="NAME=DEGREES",
    help="A mesh by its name, and how far the plate lay turned on its seat when it was probed, "
    "counter-clockwise from above; several may be given.",
)  # fmt: skip
def klipper(config: Path, out: Path, turned: tuple[str, ...]) -> None:
    """Read a linear delta's printer.cfg: its numbers, heights, distances and meshes."""
    from orthoglide.add_ons import add_on
    from orthoglide.machine_file import machine_files

    found = add_on("klipper").read(config, turned=_degrees(turned))
    machine = machine_files(found.machine, "machine.toml")
    _write(found, out, dict(machine), out / "machine.toml")


@import_.command()
@click.argument("points", metavar="FILE", type=opt.PATH)
@click.option(
    "--machine", "machine_path", type=opt.PATH, metavar="FILE", required=True,
    help="Machine file (machine.toml) of the linear delta.",
)  # fmt: skip
@opt.out(help="Folder for the campaigns; must be new or empty.")
def plates(points: Path, machine_path: Path, out: Path) -> None:
    """Read a list of a plate's points: a heightmap.csv, lines 'Bed X: Y: Z:', or x, y, z."""
    from orthoglide.firmware.plate_lists import import_plates

    machine = opt.load_machine(machine_path, None)
    _write(import_plates(points, machine.spec), out, {}, machine_path)


def _write(found: Imported, out: Path, files: dict[str, str | bytes], machine: Path) -> None:
    """Write what was imported, and say what it is and what to run next."""
    from orthoglide.observations import campaign_text

    for campaign in found.campaigns:
        files[f"{campaign.name}.csv"] = campaign_text(campaign, found.machine)
    write_results(out, files)
    for note in found.notes:
        say(f"warning: {note}", err=True)
    for campaign in found.campaigns:
        kinds = {s.name: s.kind for s in campaign.setups}
        what = ", ".join(f"{name} ({kind})" for name, kind in kinds.items())
        say(f"{campaign.name}.csv: {len(campaign)} readings: {what}")
    for line in _next(found, out, machine):
        say(line)


def _degrees(items: tuple[str, ...]) -> dict[str, float]:
    """Return by name of a mesh how far its plate was turned.

    Raises:
        InputError: where one is not of that form.
    """
    found = {}
    for item in items:
        name, _, number = (part.strip() for part in item.rpartition("="))
        try:
            found[name] = float(number)
        except ValueError:
            found[name] = math.inf
        if not name or not abs(found[name]) <= _TURN:
            raise InputError(f"--turned takes NAME=DEGREES such as default=60, not {item!r}")
    return found


def _next(found: Imported, out: Path, machine: Path) -> Iterator[str]:
    """Return what to run with the files that go together; with each alone where that is not
    known.
    """

    def command(files: str) -> str:
        file = click.format_filename(machine)
        return f"orthoglide close-loop {files} --machine {file} --out OUT"

    folder = click.format_filename(out)
    left = [f"{c.name}.csv" for c in found.campaigns if c.name not in found.together]
    if not left:
        yield f"\nNext: {command(f'{folder}/*.csv')}"
    elif found.together:
        yield f"\nNext, without {', '.join(left)}: probe again, or for now"
        yield command(" ".join(f"{folder}/{name}.csv" for name in found.together))
    else:
        yield "\nThese files must not go together. Next, probe again, or take one alone:"
        yield from (command(f"{folder}/{c.name}.csv") for c in found.campaigns)
