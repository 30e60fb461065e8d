"""Options that several commands share, as decorators, and what their values mean."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from orthoglide.cli.terminal import say
from orthoglide.errors import InputError

if TYPE_CHECKING:
    from orthoglide.machine import Machine

Command = TypeVar("Command", bound=Callable[..., Any])
Decorator = Callable[[Command], Command]

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


def machine_option(command: Command) -> Command:
    """``--machine FILE``."""
    return click.option(
        "--machine",
        "machine_path",
        type=PATH,
        metavar="FILE",
        help="Machine file (machine.toml); the nominal Orthoglide where absent.",
    )(command)


def effects_option(command: Command) -> Command:
    """``--effects-file FILE.py``."""
    return click.option(
        "--effects-file",
        type=PATH,
        metavar="FILE.py",
        help="Python file with effects of your own, beside the catalogue.",
    )(command)


def out_option(required: bool = True, help: str = "") -> Decorator[Any]:
    """``--out DIR`` of the commands that write a folder."""
    return click.option(
        "--out",
        type=PATH,
        metavar="DIR",
        required=required,
        help=help or "Folder for the results; must be new or empty.",
    )


def run_options(command: Command) -> Command:
    """``--seed``, ``--quiet`` and ``--json``."""
    options = (
        click.option("--seed", type=int, default=0, show_default=True, help="Of all random draws."),
        click.option("--quiet", is_flag=True, help="No progress and no tables."),
        click.option("--json", "as_json", is_flag=True, help="Print result.json and nothing else."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def fit_options(command: Command) -> Command:
    """What every fit takes: ``--own``, ``--machine``, ``--fit-tcp``, ``--noise`` and their like."""
    options = (
        click.option(
            "--own",
            type=Names(),
            default=(),
            metavar="NAME,...",
            help="What each campaign has for itself while the rest is shared.",
        ),
        machine_option,
        effects_option,
        click.option(
            "--fit-tcp",
            type=PATH,
            multiple=True,
            metavar="FILE",
            help="TCP points that are readings like the others; may be given several times.",
        ),
        click.option(
            "--frame",
            type=click.Choice(("rigid", "translation", "none")),
            default="rigid",
            show_default=True,
            help="How the instrument of --fit-tcp may stand to the machine.",
        ),
        click.option(
            "--noise",
            "noise_mm",
            type=float,
            metavar="MM",
            help="Standard deviation of one reading; else from machine file, rows or repeats.",
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


def quantities(option: str, items: tuple[str, ...]) -> dict[str, float]:
    """``NAME=NUMBER`` of an option in SI; the number is in the unit of files, of TCP millimetres.

    Args:
        option: its name, for errors.
        items: its values.

    Raises:
        InputError: where one is not of this form, or names nothing.
    """
    from orthoglide.effects import CATALOGUE

    found = {}
    for item in items:
        name, _, number = item.partition("=")
        try:
            value = float(number)
        except ValueError:
            example = f"{CATALOGUE.base[0]}.x=0.5"
            raise InputError(
                f"{option} takes NAME=NUMBER such as {example}, not {item!r}"
            ) from None
        found[name] = value * (1e-3 if name == "TCP" else CATALOGUE.effect_of(name).unit.si)
    return found


_NOISE = (1e-6, 1e3)  # millimetres: an atom, and more than any dial shows


def noise_metres(noise_mm: float | None) -> float | None:
    """The standard deviation of ``--noise``; `InputError` where no dial can have it."""
    if noise_mm is None:
        return None
    low, high = _NOISE
    if not low <= noise_mm <= high:
        raise InputError(
            f"--noise must be a positive number of millimetres from {low:g} to {high:g}, "
            f"not {noise_mm:g}"
        )
    return noise_mm * 1e-3


def load_machine(path: Path | None, effects_file: Path | None = None) -> Machine:
    """The machine of ``--machine``, with the effects of ``--effects-file``."""
    from orthoglide.effects.loading import load_effects
    from orthoglide.klipper.firmware import firmware_of, rods_words
    from orthoglide.machine import Machine

    effects = () if effects_file is None else load_effects(effects_file)
    machine = Machine.nominal() if path is None else Machine.load(path, effects)
    firmware = firmware_of(machine)
    doubts = [] if firmware is None else [rods_words(firmware)]
    for warning in filter(None, (*doubts, *machine.warnings)):
        say(f"warning: {warning}", err=True)
    return machine.with_effects(effects)
