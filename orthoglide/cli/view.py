"""``view``: a machine in Pinocchio's meshcat viewer."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import click

import orthoglide.cli.options as opt
from orthoglide.cli.idle import exclude, need
from orthoglide.cli.terminal import say


@click.command()
@click.argument("machine", type=opt.PATH, required=False)
@click.option(
    "--magnify", type=float, default=1.0, show_default=True, metavar="X",
    help="Factor by which errors are enlarged.",
)  # fmt: skip
@click.option(
    "--out", type=opt.PATH, metavar="FILE.html",
    help="Write a page that needs no network, and open no viewer; a new file.",
)  # fmt: skip
@click.option("--no-open", is_flag=True, help="Print the viewer's address, and open no browser.")
@opt.effects
def view(
    machine: Path | None,
    magnify: float,
    out: Path | None,
    no_open: bool,
    effects_file: Path | None,
) -> None:
    """Show MACHINE in three dimensions; the nominal Orthoglide where absent.

    It stands at mechanical zero, and its controls move the tool along x, y and z. What depends on
    approach, time, temperature or load is drawn after a move outward, an hour later, 10 K warmer,
    under 10 N. The viewer is meshcat: pip install orthoglide[viewer].
    """
    from orthoglide.cli.writing import write_texts
    from orthoglide.pictures import SHOWN
    from orthoglide.viewer import Magnified, show, static_page

    need("effects_file", "machine")
    exclude("out", "no_open", because="a page is written, and no viewer is opened")
    shown = opt.load_machine(machine, effects_file)
    zero, drawn = shown.geometry.zero, Magnified(shown.model, shown.values, SHOWN, magnify)
    with redirect_stdout(StringIO()):  # meshcat prints the address of its server
        viewer = show(drawn, zero, open_browser=out is None and not no_open)
    off = shown.forward(zero, **SHOWN) - shown.with_only({}).forward(zero)
    size = ", ".join(f"{1e3 * v + 0.0:.3f}" for v in off)
    scale = "true to scale" if magnify == 1 else f"errors {magnify:g} times as large"
    told = f"{scale}; its errors put the tool {size} mm off in x, y and z"
    told = told if shown.values else "without errors"
    if out is not None:
        write_texts({out: static_page(viewer, drawn, shown.spec.title)})
        say(f"{click.format_filename(out)}: the machine, {told}")
        return
    say(f"{viewer.viewer.url()} shows the machine, {told}")
    click.pause("Press a key to end the viewer.")  # at once where nobody is at a terminal
