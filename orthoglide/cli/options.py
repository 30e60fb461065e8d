"""Options that several commands share, as decorators, and what their values mean."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from orthoglide.cli.app import warn
from orthoglide.errors import InputError
from orthoglide.files import check_new
from orthoglide.units import NOISE_LIMITS

if TYPE_CHECKING:
    from orthoglide.effects import Catalogue, Effect
    from orthoglide.machine import Machine

Decorator = Callable[[Any], Any]

PATH = click.Path(path_type=Path)
"""A file or folder; whether it exists and is readable is checked where it is read."""

DIAL_PROTOCOLS = ("standard", "sweep", "two-gauges")
PROTOCOLS = (*DIAL_PROTOCOLS, "parallelism")

Pairs = tuple[tuple[str, float], ...]
"""Names with their numbers, as they were given."""

CALIBRATED = "calibrated.toml"
"""The calibrated machine in the folder of a result."""


def shell_path(path: Path) -> str:
    """Return a path as it is typed on a command line."""
    return shlex.quote(click.format_filename(path))


def combine_options(*options: Decorator) -> Decorator:
    """Return several options as one decorator; help lists them in this order."""

    def decorate(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def _split_commas(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def names(option: str, help: str, metavar: str = "NAME,...") -> Decorator:
    """Return an option that takes names separated by commas, a tuple in Python."""

    def split(_: Any, __: Any, text: str | None) -> tuple[str, ...]:
        given = tuple(_split_commas(text or ""))
        if text is not None and not given:
            raise InputError(f"{option} takes {metavar}, not {text!r}: give some, or leave it out")
        return given

    return click.option(option, callback=split, metavar=metavar, help=help)


def pairs(option: str, help: str, metavar: str) -> Decorator:
    """Return an option that takes numbers by name, as `Pairs`; it may be given several times."""

    def parse(_: Any, __: Any, texts: tuple[str, ...]) -> Pairs:
        numbers = list[tuple[str, float]]()
        for item in (item for text in texts for item in _split_commas(text)):
            name, _, number = (part.strip() for part in item.rpartition("="))
            value = math.nan
            with suppress(ValueError):
                value = float(number)
            if not name or not math.isfinite(value):
                form = metavar.rstrip(",.")
                raise InputError(f"{option} takes {form}, a finite number, not {item!r}")
            numbers.append((name, value))
        return tuple(numbers)

    return click.option(option, multiple=True, callback=parse, metavar=metavar, help=help)


def flag(option: str, help: str) -> Decorator:
    """Return an option that takes no value."""
    return click.option(option, is_flag=True, help=help)


def file(option: str, help: str, metavar: str = "FILE", **more: Any) -> Decorator:
    """Return an option that takes a path."""
    return click.option(option, type=PATH, metavar=metavar, help=help, **more)


@dataclass(frozen=True)
class MachineOption:
    """The machine that a command was given, read where it is needed."""

    path: Path | None  # of the machine file; `None` for the nominal Orthoglide
    effects_file: Path | None  # with the user's own effects

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The user's own effects."""
        from orthoglide.effects.custom import load_effects

        return load_effects(self.effects_file)

    @property
    def words(self) -> str:
        """Options of the command line that give this machine."""
        paths = {"--machine": self.path, "--effects-file": self.effects_file}
        return "".join(f" {option} {shell_path(path)}" for option, path in paths.items() if path)

    def with_typed_paths(self, text: str, out: Path) -> str:
        """Return a text of a result with complete paths in the commands that it advises.

        Results name files without folders; that of the calibrated machine is ``out``.
        """
        machines = [("--machine", path) for path in (out / CALIBRATED, self.path)]
        for option, path in (*machines, ("--effects-file", self.effects_file)):
            if path is not None:
                file = shlex.quote(path.name)
                text = text.replace(f"{option} {file}", f"{option} {shell_path(path)}")
        return text

    def load(self, doubts: bool = True) -> Machine:
        """Return the machine, and print warnings, without ``doubts`` those that begin a result."""
        machine = self.read()
        warn_of(machine, doubts=doubts)
        return machine

    def read(self) -> Machine:
        """Return the machine without printing warnings, for commands that do not use all of it."""
        from orthoglide.machine import Machine

        return Machine.of(self.path, self.effects)


def warn_of(machine: Machine, *, covariance: bool = True, doubts: bool = True) -> None:
    """Print warnings about a machine's file; without ``covariance`` not that this is missing."""
    printer = machine.spec.printer
    text = printer.doubts(machine) if doubts and printer is not None else ""
    notes = (n for n in machine.spec.warnings if covariance or n.kind != "covariance")
    warn(tuple(filter(None, (text, *notes))))


def machine(required: bool = False) -> Decorator:
    """Return the options ``--machine FILE`` and ``--effects-file``, together a `MachineOption`."""

    def combine(context: click.Context, _: Any, path: Path | None) -> MachineOption:
        return MachineOption(path, context.params.pop("effects_file", None))

    ending = "." if required else "; the nominal Orthoglide if absent."
    return combine_options(
        file("--machine", f"Machine file; the option's name may be omitted{ending}", "FILE.toml",
             required=required, callback=combine),
        file("--effects-file", "Python file with effects of your own, beside the catalogue.",
             "FILE.py", is_eager=True),
    )  # fmt: skip


def out(
    help: str = "Folder for the results; must be new or empty.", metavar: str = "DIR", **more: Any
) -> Decorator:
    """Return the option ``--out``, a new folder or a new file, refused before any work is done."""

    def check(context: click.Context, _: Any, path: Path | None) -> Path | None:
        if path is not None and not context.resilient_parsing:
            if metavar == "DIR":
                from orthoglide.report.folder import check_folder

                check_folder(path)
            else:
                check_new(path)
        return path

    return file("--out", help, metavar, callback=check, **more)


seed = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random draws."
)
quiet = flag("--quiet", "No progress; the answer in one line.")


def noise(default_text: str = "the machine file's", minimum: float = NOISE_LIMITS[0]) -> Decorator:
    """Return the option ``--noise MM``, metres in Python and no less than ``minimum``; help says
    which value is used without it.
    """

    def metres(_: Any, __: Any, value: float | None) -> float | None:
        if value is None:
            return None
        if minimum <= value * 1e-3 <= NOISE_LIMITS[1]:
            return value * 1e-3
        raise InputError(
            f"--noise must be a number of millimetres from {minimum * 1e3:g} to "
            f"{NOISE_LIMITS[1] * 1e3:g}, not {value:g}"
        )

    return click.option(
        "--noise", type=float, metavar="MM", callback=metres,
        help=f"Standard deviation of one reading of a leg, or of the tool where no leg is read; "
             f"else {default_text}.",
    )  # fmt: skip


def values_in_si(option: str, numbers: Pairs, catalogue: Catalogue) -> dict[str, float]:
    """Return the numbers of an option by name, in SI; they are given in the units of files, that of
    TCP in millimetres.
    """
    values = dict[str, float]()
    for name, value in numbers:
        if name in values:
            raise InputError(f"{option} has {name} twice: give it once")
        values[name] = value * (1e-3 if name == "TCP" else catalogue.effect_of(name).unit.si)
    return values


def exclude(option: str, *others: str, because: str) -> None:
    """Refuse options, by their names in Python, that have no effect together with another one;
    ``because`` is the reason.
    """
    context, texts = click.get_current_context(), dict[str | None, str]()
    for parameter in context.command.params:
        texts[parameter.name] = max(parameter.opts, key=len)
        if isinstance(parameter, click.Argument):
            metavar = parameter.metavar or parameter.human_readable_name
            texts[parameter.name] = metavar.strip("[] .")

    def given(name: str) -> bool:
        typed = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        return typed and context.params[name] != ()

    for other in filter(given, others if given(option) else ()):
        raise InputError(f"{texts[option]} and {texts[other]} exclude each other: {because}")
