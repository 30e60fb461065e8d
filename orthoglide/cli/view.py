"""``view``: a machine to turn and move in a browser."""

from __future__ import annotations

from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.idle import need
from orthoglide.cli.terminal import say

_NOMINAL = "orthoglide"


@click.command()
@click.argument("machine", type=opt.PATH, required=False)
@click.option(
    "--out", type=opt.PATH, metavar="FILE",
    help=f"Page to write; a new file.  [default: the machine file's name or {_NOMINAL}, .html]",
)  # fmt: skip
@opt.effects
def view(machine: Path | None, out: Path | None, effects_file: Path | None) -> None:
    """Write a page that shows MACHINE in three dimensions; the nominal Orthoglide where absent.

    It moves through its workspace. Each of its errors can be switched on and magnified, and arrows
    show how far the tool is off. The page needs no network.
    """
    from orthoglide.cli.writing import next_free, write_texts
    from orthoglide.pictures import causes_of, option, view as view_of
    from orthoglide.scene import drawing, view_page

    need("effects_file", "machine")
    shown = opt.load_machine(machine, effects_file)
    causes = causes_of(shown)
    options = [option(shown, words, values) for words, values in causes[:1]]
    title = f"The machine {shown.spec.name}".rstrip()
    still = drawing(shown.with_only({}).posed(), options, title=title)
    out = out or next_free(Path(f"{machine.stem if machine else _NOMINAL}.html"))
    write_texts({out: view_page(view_of(shown, causes), still, title)})
    more = f", with {len(causes)} of its errors to switch on" if causes else ", without errors"
    say(f"{click.format_filename(out)}: the machine to turn and move{more}")
