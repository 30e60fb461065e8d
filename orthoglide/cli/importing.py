"""``import``: a machine file and campaigns from what a firmware stored."""

from __future__ import annotations

from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.run import Listed
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_results


@click.group("import", cls=Listed)
def import_() -> None:
    """Machine file and campaigns from what a firmware stored."""


@import_.command()
@click.argument("config", type=opt.PATH)
@opt.out(help="Folder for machine.toml and the campaigns; must be new or empty.")
def klipper(config: Path, out: Path) -> None:
    """Read a linear delta's printer.cfg: its numbers, heights, distances and meshes."""
    from orthoglide.klipper import import_printer
    from orthoglide.machine_file import machine_files
    from orthoglide.observations import csv_text, tool_rows
    from orthoglide.report.folder import check_folder

    check_folder(out)
    found = import_printer(config)
    files: dict[str, str | bytes] = dict(machine_files(found.machine, "machine.toml"))
    for campaign in found.campaigns:
        files[f"{campaign.name}.csv"] = csv_text(tool_rows(campaign, found.machine))
    write_results(out, files)
    for note in found.notes:
        say(f"warning: {note}", err=True)
    for campaign in found.campaigns:
        kinds = {s.name: s.kind for s in campaign.setups}
        what = ", ".join(f"{name} ({kind})" for name, kind in kinds.items())
        say(f"{campaign.name}.csv: {len(campaign)} readings: {what}")
    say(
        f"\nNext: orthoglide close-loop {click.format_filename(out)}/*.csv --machine "
        f"{click.format_filename(out / 'machine.toml')} --out OUT"
    )


COMMANDS = (import_,)
