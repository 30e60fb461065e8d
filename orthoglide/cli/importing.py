"""``import``: a machine file and campaigns from what a firmware stored."""

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
from orthoglide.errors import InputError, NumericsError

if TYPE_CHECKING:
    from orthoglide.klipper import Imported


_TURN = 360.0  # degrees


@click.group("import", cls=Listed)
def import_() -> None:
    """Machine file and campaigns from what a firmware stored."""


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
    from orthoglide.klipper import import_printer
    from orthoglide.machine_file import machine_files
    from orthoglide.observations import campaign_text

    found = import_printer(config, _degrees(turned))
    files: dict[str, str | bytes] = dict(machine_files(found.machine, "machine.toml"))
    for campaign in found.campaigns:
        files[f"{campaign.name}.csv"] = campaign_text(campaign, found.machine)
    proposed = list(_next(found, out))
    write_results(out, files)
    for note in found.notes:
        say(f"warning: {note}", err=True)
    for campaign in found.campaigns:
        kinds = {s.name: s.kind for s in campaign.setups}
        what = ", ".join(f"{name} ({kind})" for name, kind in kinds.items())
        say(f"{campaign.name}.csv: {len(campaign)} readings: {what}")
    for line in proposed:
        say(line)


def _degrees(items: tuple[str, ...]) -> dict[str, float]:
    """By name of a mesh how far its plate was turned.

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


def _next(found: Imported, out: Path) -> Iterator[str]:
    """What to run with the files that go together; with each alone where that is not known."""

    def command(files: str) -> str:
        machine = click.format_filename(out / "machine.toml")
        return f"orthoglide close-loop {files} --machine {machine} --out OUT"

    folder = click.format_filename(out)
    absurd = dict(_absurd(found))
    for name, reason in absurd.items():
        yield f"\nclose-loop would refuse {name}.csv ({reason}): probe it again"
    names = [name for name in found.together if name not in absurd]
    out_of = list(dict.fromkeys([*(one.name for one in found.apart), *absurd]))
    if len(absurd) == len(found.campaigns):
        return
    if not out_of:
        yield f"\nNext: {command(f'{folder}/*.csv')}"
    elif names:
        left = ", ".join(f"{name}.csv" for name in out_of)
        yield f"\nNext, without {left}: probe again, or for now"
        yield command(" ".join(f"{folder}/{name}.csv" for name in names))
    else:
        yield "\nThese files must not go together. Next, probe again, or take one alone:"
        alone = (c.name for c in found.campaigns if c.name not in absurd)
        yield from (command(f"{folder}/{name}.csv") for name in alone)


def _absurd(found: Imported) -> Iterator[tuple[str, str]]:
    """Names of readings with touches so far from all others that close-loop refuses them, and why.

    Only of the rough ones is it asked.
    """
    import orthoglide as og

    machine = og.Machine(found.machine)
    for campaign in found.rough:
        try:
            og.identify([campaign], machine)
        except (InputError, NumericsError) as error:
            yield campaign.name, str(error).partition(": correct")[0]
