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
"""A file or folder; that it is there and readable is checked where it is read."""

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
    """Return an option that takes names parted by commas, a tuple in Python."""

    def every(_: Any, __: Any, given: str) -> tuple[str, ...]:
        return tuple(_split_commas(given))

    return click.option(option, default="", callback=every, metavar=metavar, help=help)


def pairs(option: str, help: str, metavar: str) -> Decorator:
    """Return an option that takes numbers by name, as `Pairs`; it may be given several times."""

    def every(_: Any, __: Any, given: tuple[str, ...]) -> Pairs:
        found = list[tuple[str, float]]()
        for item in (item for text in given for item in _split_commas(text)):
            name, _, number = (part.strip() for part in item.rpartition("="))
            value = math.nan
            with suppress(ValueError):
                value = float(number)
            if not name or not math.isfinite(value):
                form = metavar.rstrip(",.")
                raise InputError(f"{option} takes {form}, a finite number, not {item!r}")
            found.append((name, value))
        return tuple(found)

    return click.option(option, multiple=True, callback=every, metavar=metavar, help=help)


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
        """The options of the command line that give this machine."""
        given = {"--machine": self.path, "--effects-file": self.effects_file}
        return "".join(f" {o} {shell_path(p)}" for o, p in given.items() if p)

    def with_typed_paths(self, text: str, out: Path) -> str:
        """Return a text of a result with files in advised commands as they are typed here: results
        name them without folders.

        Args:
            text: of the result.
            out: folder with its calibrated machine.
        """
        machines = [("--machine", path) for path in (out / CALIBRATED, self.path)]
        for option, path in (*machines, ("--effects-file", self.effects_file)):
            if path is not None:
                file = shlex.quote(path.name)
                text = text.replace(f"{option} {file}", f"{option} {shell_path(path)}")
        return text

    def load(self) -> Machine:
        """Return the machine, and print what is doubtful about its file.

        Raises:
            FileError: naming file, line and remedy.
        """
        from orthoglide.machine import Machine

        effects = self.effects
        machine = Machine.nominal() if self.path is None else Machine.load(self.path, effects)
        printer = machine.spec.printer
        doubts = "" if printer is None else printer.doubts(machine)
        warn(tuple(filter(None, (doubts, *machine.warnings))))
        return machine.with_effects(effects)


def machine(required: bool = False) -> Decorator:
    """Return ``--machine FILE`` with ``--effects-file``, together a `MachineOption`."""
    key = "orthoglide.effects_file"

    def remember(context: click.Context, _: Any, value: Path | None) -> None:
        context.meta[key] = value

    def both(context: click.Context, _: Any, value: Path | None) -> MachineOption:
        return MachineOption(value, context.meta.get(key))

    otherwise = "." if required else "; the nominal Orthoglide if absent."
    return combine_options(
        file("--machine", f"Machine file, also by itself{otherwise}", "FILE.toml",
             required=required, callback=both),
        file("--effects-file", "Python file with effects of your own, beside the catalogue.",
             "FILE.py", is_eager=True, expose_value=False, callback=remember),
    )  # fmt: skip


def _path_callback(check: Callable[[Path], None]) -> Callable[..., Path | None]:
    """Return the callback of an option that looks at a path before any work is done."""

    def callback(context: click.Context, _: Any, path: Path | None) -> Path | None:
        if path is not None and not context.resilient_parsing:
            check(path)
        return path

    return callback


def _check_folder(path: Path) -> None:
    from orthoglide.report.folder import check_folder

    check_folder(path)


def out(help: str = "Folder for the results; must be new or empty.", **more: Any) -> Decorator:
    """Return ``--out DIR`` of a new folder."""
    return file("--out", help, "DIR", callback=_path_callback(_check_folder), **more)


def out_file(help: str, metavar: str, **more: Any) -> Decorator:
    """Return ``--out FILE`` of a new file."""
    return file("--out", help, metavar, callback=_path_callback(check_new), **more)


seed = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random draws."
)
quiet = flag("--quiet", "No progress; the answer in one line.")


def noise(otherwise: str = "the machine file's", minimum: float = NOISE_LIMITS[0]) -> Decorator:
    """Return ``--noise MM``, metres in Python.

    Args:
        otherwise: what counts where it is absent.
        minimum: the smallest that is taken, metres.
    """

    def metres(_: Any, __: Any, value: float | None) -> float | None:
        if value is None or minimum <= value * 1e-3 <= NOISE_LIMITS[1]:
            return None if value is None else value * 1e-3
        raise InputError(
            f"--noise must be a number of millimetres from {minimum * 1e3:g} to "
            f"{NOISE_LIMITS[1] * 1e3:g}, not {value:g}"
        )

    return click.option(
        "--noise", type=float, metavar="MM", callback=metres,
        help=f"Standard deviation of one reading of a leg, or of the tool where no leg is read; "
             f"else {otherwise}.",
    )  # fmt: skip


def values_in_si(option: str, given: Pairs, catalogue: Catalogue) -> dict[str, float]:
    """Return numbers by name in SI, of an option in the units of files; that of TCP in millimetres.

    Raises:
        InputError: if a name is given twice, or is none.
    """
    found = dict[str, float]()
    for name, value in given:
        if name in found:
            raise InputError(f"{option} has {name} twice: give it once")
        found[name] = value * (1e-3 if name == "TCP" else catalogue.effect_of(name).unit.si)
    return found


def exclude(one: str, *others: str, because: str) -> None:
    """Refuse options that have no effect beside another; all by their names in Python.

    Raises:
        InputError: if ``one`` and one of the others were given; ``because`` says why not.
    """
    context = click.get_current_context()
    shown = {p.name: _option_text(p) for p in context.command.params}

    def given(name: str) -> bool:
        default = context.get_parameter_source(name) in (None, ParameterSource.DEFAULT)
        return not default and context.params[name] not in (None, ())

    for other in filter(given, others if given(one) else ()):
        raise InputError(f"{shown[one]} and {shown[other]} exclude each other: {because}")


def _option_text(parameter: click.Parameter) -> str:
    """Return a parameter as it is written on the command line."""
    if isinstance(parameter, click.Argument):
        return (parameter.metavar or parameter.human_readable_name).strip("[] .")
    return max(parameter.opts, key=len)
