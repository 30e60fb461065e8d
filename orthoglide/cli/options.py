"""Options that several commands share, as decorators, and what their values mean."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orthoglide.cli.terminal import say
from orthoglide.errors import FileError, InputError
from orthoglide.text import shown
from orthoglide.units import NOISE

if TYPE_CHECKING:
    from orthoglide.effects import Catalogue
    from orthoglide.machine import Machine
    from orthoglide.observations import Readings

Decorator = Callable[[Any], Any]

PATH = click.Path(path_type=Path)
"""A file or folder; that it is there and readable is checked where it is read."""


class Names(click.ParamType):
    """Names parted by commas."""

    name = "NAME,..."

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """A tuple of names."""
        if isinstance(value, tuple):
            return value
        return tuple(part.strip() for part in str(value).split(",") if part.strip())


def together(*options: Decorator) -> Decorator:
    """Several options as one decorator; help lists them in this order."""

    def decorate(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


DIAL_PROTOCOLS = ("standard", "sweep", "two-gauges")
PROTOCOLS = (*DIAL_PROTOCOLS, "parallelism")

effects = click.option(
    "--effects-file", type=PATH, metavar="FILE.py",
    help="Python file with effects of your own, beside the catalogue.",
)  # fmt: skip


def machine(required: bool = False, help: str = "") -> Decorator:
    """``--machine FILE``, and ``--effects-file`` for what it may name beside the catalogue."""
    usual = "Machine file (machine.toml); the nominal Orthoglide where absent."
    return together(
        click.option("--machine", "machine_path", type=PATH, metavar="FILE", required=required,
                     help=help or usual),
        effects,
    )  # fmt: skip


def _seed_of(_: Any, __: Any, value: int) -> int:
    if value < 0:
        raise InputError(f"--seed must be 0 or more, not {value}")
    return value


seed = click.option(
    "--seed", type=int, default=0, show_default=True, callback=_seed_of,
    help="Seed of all random draws.",
)  # fmt: skip
quiet = click.option(
    "--quiet",
    is_flag=True,
    help="No progress and no tables: one line where no file is written.",
)


def _free(context: click.Context, _: Any, folder: Path | None) -> Path | None:
    from orthoglide.report.folder import check_folder

    if folder is not None and not context.resilient_parsing:
        check_folder(folder)
    return folder


def out(required: bool = True, help: str = "") -> Decorator:
    """``--out DIR`` of the commands that write a new folder: refused before any work is done."""
    usual = "Folder for the results; must be new or empty."
    return click.option(
        "--out", type=PATH, metavar="DIR", required=required, help=help or usual, callback=_free
    )


out_or_nothing = out(False, "Folder for the results; nothing is written where absent.")


def quantities(option: str, items: tuple[str, ...], catalogue: Catalogue) -> dict[str, float]:
    """``NAME=NUMBER`` of an option in SI; the number is in the unit of files, of TCP millimetres.

    Raises:
        InputError: where one is not of this form, or names nothing.
    """
    found: dict[str, float] = {}
    for item in items:
        name, _, number = item.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not name or not math.isfinite(value):
            example = f"{catalogue.base[0]}.x=0.5"
            raise InputError(f"{option} takes NAME=NUMBER such as {example}, not {item!r}")
        if name in found:
            raise InputError(f"{option} has {name} twice: give it once")
        found[name] = value * (1e-3 if name == "TCP" else catalogue.effect_of(name).unit.si)
    return found


def noise(otherwise: str = "the machine file's", least: float = NOISE[0]) -> Decorator:
    """``--noise MM`` as metres, what counts where it is absent, and the least, metres."""

    def _metres(_: Any, __: Any, value: float | None) -> float | None:
        if value is None or least <= value * 1e-3 <= NOISE[1]:
            return None if value is None else value * 1e-3
        raise InputError(
            f"--noise must be a number of millimetres from {least * 1e3:g} to "
            f"{NOISE[1] * 1e3:g}, not {value:g}"
        )

    return click.option(
        "--noise", type=float, metavar="MM",
        callback=_metres,
        help=f"Standard deviation of one reading of a leg, or of the tool where no leg is read; "
             f"else {otherwise}.",
    )  # fmt: skip


run_options = together(
    seed,
    quiet,
    click.option("--json", "as_json", is_flag=True, help="Print result.json and nothing else."),
)

fit_options = together(
    click.option("--own", type=Names(), default=(), metavar="NAME,...",
                 help="Effects or parameters that each campaign has of its own."),
    machine(),
    click.option("--fit-tcp", type=PATH, multiple=True, metavar="FILE",
                 help="TCP points that are readings like the others; may be given several times."),
    click.option("--frame", type=click.Choice(("rigid", "translation", "none")), default="rigid",
                 show_default=True,
                 help="How the instrument of --fit-tcp may stand to the machine."),
    noise("from machine file, rows or repeats"),
)  # fmt: skip


def dial_sheet(path: Path, machine: Machine, otherwise: str) -> Readings:
    """A measuring sheet of single dials on legs, filled in or not; ``otherwise`` is what to do with
    one of other readings, as a clause.

    Raises:
        FileError: where it cannot be read, or holds other readings.
    """
    from orthoglide.observations import read_readings

    sheet = read_readings(path, machine.spec, require_readings=False)[-1]
    others = dict.fromkeys(s.kind for s in sheet.setups if s.observation.dials != 1)
    if others:
        what = "readings at the tool" if sheet.of_tool else "readings of two dials at a time"
        raise FileError(f"holds {what} ({', '.join(others)}): {otherwise}", file=shown(path))
    return sheet


def load_machine(path: Path | None, effects_file: Path | None) -> Machine:
    """The machine of ``--machine``, with the effects of ``--effects-file``."""
    from orthoglide.effects.loading import load_effects
    from orthoglide.machine import Machine

    effects = load_effects(effects_file)
    machine = Machine.nominal() if path is None else Machine.load(path, effects)
    doubts = "" if machine.spec.printer is None else machine.spec.printer.doubts(machine)
    for warning in filter(None, (doubts, *machine.warnings)):
        say(f"warning: {warning}", err=True)
    return machine.with_effects(effects)
