"""``rerun``: a result's numbers again, from the rows that it keeps."""

from __future__ import annotations

import csv
import io
import json
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orthoglide.cli.options import PATH, out_option
from orthoglide.cli.progress import Step, bar
from orthoglide.errors import FileError, NumericsError

if TYPE_CHECKING:
    from orthoglide.machine import Machine
    from orthoglide.observations import Campaign
    from orthoglide.report import InputFile, Run

COMMANDS_KNOWN = ("identify", "close-loop", "diagnose", "demo")
SAME = 1e-6
"""Relative difference up to which numbers count as equal: other processors round otherwise."""

_TINY = 1e-9  # millimetres, or what else a number stands for: rounding of what should be zero
_APART = ("version", "inputs", "machine", "method")  # what a run is told, or how it got there
_FEW_SAID = 5


@click.command()
@click.argument("result", type=PATH, metavar="result.json")
@out_option(required=False, help="Folder for the results; nothing is written where absent.")
@click.option("--inputs", type=PATH, metavar="FOLDER",
              help="Where the files lie that were read; else beside the result and above it.")  # fmt: skip
@click.option("--quiet", is_flag=True, help="No progress; only what differs is told.")
def rerun(result: Path, out: Path | None, inputs: Path | None, quiet: bool) -> None:
    """Do a run again from the rows kept in its result, and compare the numbers.

    Tells which of the files that were read have changed since. Exit code 0 where the numbers are
    the same, 3 where they are not.
    """
    from orthoglide.report.folder import check_folder, write_folder

    if out is not None:
        check_folder(out)
    old = read_result(result)
    with bar(quiet) as step:
        step("reading")
        kept = Kept.of(old, result)
        files = kept.files(step, whole=out is not None)
        new = json.loads(files["result.json"])
        differences = list(compare(_numbers(old), _numbers(new)))
        if out is not None and not differences:
            write_folder(out, files)
    folders = (inputs,) if inputs else (result.parent, result.parent.parent, Path())
    for line in input_lines(old, folders):
        if not quiet or "changed" in line:
            click.echo(line)
    if old["version"] != new["version"]:
        click.echo(f"The result was made by version {old['version']}, this is {new['version']}.")
    if differences:
        shown = "; ".join(differences[:_FEW_SAID])
        more = len(differences) - _FEW_SAID
        tail = f"; and {more} more" if more > 0 else ""
        raise NumericsError(
            f"{click.format_filename(result)} is not reproduced: {shown}{tail}; nothing was written"
        )
    if not quiet:
        count = sum(1 for _ in leaves(_numbers(new)))
        click.echo(f"The same numbers again: all {count} agree.")
        if out is not None:
            click.echo(f"Report: {click.format_filename(out / 'report.html')}")


COMMANDS = (rerun,)


def read_result(path: Path) -> dict[str, Any]:
    """A ``result.json`` that can be run again.

    Raises:
        FileError: where it is none.
    """
    from orthoglide.files import decode, read_bytes

    try:
        found = json.loads(decode(read_bytes(path), path))
    except json.JSONDecodeError as error:
        raise FileError(
            f"is not JSON ({error.msg}): give the result.json of a run",
            file=str(path), line=error.lineno,
        ) from None  # fmt: skip
    needed = ("schema", "version", "command", "arguments", "seed", "inputs", "machine")
    missing = [n for n in needed if not isinstance(found, dict) or n not in found]
    if missing:
        raise FileError(
            f"has no {missing[0]!r}: give the result.json of a run as it was written",
            file=str(path),
        )
    if found["schema"] != 1 or found["command"] not in COMMANDS_KNOWN:
        raise FileError(
            f"is of schema {found['schema']}, command {found['command']!r}: this version runs "
            f"schema 1 of {', '.join(COMMANDS_KNOWN)} again",
            file=str(path),
        )
    return found


@dataclass(frozen=True)
class Kept:
    """What a result keeps of its run.

    Attributes:
        command: that was run.
        arguments: of it.
        seed: of it.
        inputs: files with their rows.
        machine: it started from.
        file: name of the result, for errors.
    """

    command: str
    arguments: Mapping[str, Any]
    seed: int
    inputs: tuple[InputFile, ...]
    machine: Machine
    file: str

    @classmethod
    def of(cls, result: Mapping[str, Any], path: Path) -> Kept:
        """Read it.

        Raises:
            FileError: where a part of it is not as it was written.
        """
        from dataclasses import replace

        from orthoglide.machine import Machine
        from orthoglide.machine_file import parse_machine_file
        from orthoglide.report import InputFile

        try:
            inputs = tuple(
                InputFile(
                    Path(i["file"]).name, i["sha256"], tuple(i["rows"]),
                    i.get("role", "campaign"), tuple(i.get("lines", ())),
                )
                for i in result["inputs"]
            )  # fmt: skip
            told = result["machine"]
            spec = parse_machine_file(told["toml"], told["file"] or "")
            spec = replace(spec, file=told["file"] or "", sha256=told["sha256"] or "")
            seed = int(result["seed"])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FileError(
                f"is not as it was written ({type(error).__name__}: {error}): take the original",
                file=str(path),
            ) from None
        return cls(
            result["command"], result["arguments"], seed, inputs, Machine(spec), str(path)
        )

    def files(self, step: Step, whole: bool) -> dict[str, str]:
        """The files of the run; only ``result.json`` where not asked for whole."""
        run = self._run()
        if self.command == "identify":
            return self._identified(run, step)
        from orthoglide.closing import close_loop
        from orthoglide.report import result_text, verdict_files
        from orthoglide.report.verdict_view import View

        points = self._points()
        verdict = close_loop(
            self._campaigns("campaign"),
            self.machine,
            own=tuple(self.arguments["own"]),
            noise=self._noise,
            holdout=next(iter(self._campaigns("holdout")), None),
            tcp=points,
            seed=self.seed,
            progress=step,
        )
        view = View(verdict)
        return verdict_files(view, run, step) if whole else {"result.json": result_text(view, run)}

    def _identified(self, run: Run, step: Step) -> dict[str, str]:
        from orthoglide.identification import identify
        from orthoglide.report import identification_files

        campaigns, arguments = self._campaigns("campaign"), self.arguments
        step(f"identifying from {sum(map(len, campaigns))} readings")
        estimate = identify(
            campaigns,
            self.machine,
            tuple(arguments["free"]),
            own=tuple(arguments["own"]),
            priors=arguments["priors"],
            noise=self._noise,
            method="reduction" if arguments["reduced"] else "auto",
        )
        return identification_files(estimate, run)

    @property
    def _noise(self) -> float | None:
        noise = self.arguments["noise_mm"]
        return None if noise is None else noise * 1e-3

    def _run(self) -> Run:
        from orthoglide.cli import closing, identification
        from orthoglide.report import Run

        told = self.arguments
        machine = Path(told["machine"]) if told.get("machine") else None
        paths = tuple(Path(name) for name in told["campaigns"])
        own, noise = tuple(told["own"]), told["noise_mm"]
        if self.command == "identify":
            asked = identification.Asked(
                tuple(told["free"]), told["priors"], own, machine, told["reduced"], noise, self.seed
            )
            again = asked.command_line(paths)
        elif self.command == "demo":
            again = closing.demo_line(self.seed)
        else:
            judges = (Path(told[k]) if told[k] else None for k in ("holdout", "tcp"))
            again = closing.Asked(paths, *judges, own, machine, noise, self.seed).command_line(
                self.command
            )
        return Run(self.command, told, self.inputs, self.seed, again)

    def _campaigns(self, role: str) -> list[Campaign]:
        from dataclasses import replace

        from orthoglide.observations import read_campaign

        found = []
        for kept in self.inputs:
            if kept.role == role:
                with written(kept) as path:
                    campaign = read_campaign(path, self.machine.spec)
                found.append(replace(campaign, file=kept.file, sha256=kept.sha256))
        return found

    def _points(self) -> Any:
        from dataclasses import replace

        from orthoglide.observations import read_tcp

        for kept in self.inputs:
            if kept.role == "tcp":
                with written(kept) as path:
                    points = read_tcp(path, self.machine.spec)
                return replace(points, file=kept.file, sha256=kept.sha256)
        return None


@contextmanager
def written(kept: InputFile) -> Iterator[Path]:
    """The rows of a file as a file of its name again, for a while."""
    with tempfile.TemporaryDirectory(prefix="orthoglide-") as folder:
        path = Path(folder) / kept.file
        path.write_text(input_text(kept), encoding="utf-8", newline="")
        yield path


def input_text(kept: InputFile) -> str:
    """A file's rows as CSV, each on the line where it stood."""
    if not kept.rows:
        raise FileError("has no rows in the result: take the original", file=kept.file)
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    names = list(kept.rows[0])
    writer.writerow(names)
    now = 1
    lines = kept.lines or tuple(range(2, len(kept.rows) + 2))
    for line, row in zip(lines, kept.rows, strict=True):
        cells = [str(row.get(name, "")) for name in names]
        now += 1 + sum(cell.count("\n") for cell in cells)
        stream.write("\n" * max(line - now, 0))
        now = max(line, now)
        writer.writerow(cells)
    return stream.getvalue()


def input_lines(result: Mapping[str, Any], folders: Sequence[Path]) -> Iterator[str]:
    """What became of the files that were read, a sentence each."""
    from orthoglide.files import sha256

    machine = result["machine"]
    told = [(i["file"], i["sha256"]) for i in result["inputs"]]
    if machine.get("file") and machine.get("sha256"):
        told.append((machine["file"], machine["sha256"]))
    packaged = result["command"] == "demo"
    for name, digest in () if packaged else told:
        path = next((f / name for f in folders if (f / name).is_file()), None)
        if path is None:
            yield f"{name}: not here; the rows kept in the result were used."
        elif sha256(path.read_bytes()) == digest:
            yield f"{name}: unchanged."
        else:
            yield (
                f"{name}: has changed since; the rows kept in the result were used, not the file."
            )


def _numbers(result: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in result.items() if k not in _APART}


def leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of a nested mapping with the place where it stands."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from leaves(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            yield from leaves(inner, f"{place}[{k}]")
    else:
        yield place, value


def compare(old: Any, new: Any) -> Iterator[str]:
    """Where two results differ by more than rounding, in words."""
    before, after = dict(leaves(old)), dict(leaves(new))
    for place in dict.fromkeys((*before, *after)):
        if place not in after:
            yield f"{place} was {before[place]!r} and is gone"
        elif place not in before:
            yield f"{place} is new, {after[place]!r}"
        elif not _same(before[place], after[place]):
            yield f"{place} was {before[place]!r} and is {after[place]!r}"


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, bool) or isinstance(other, bool) or isinstance(one, str):
        return bool(one == other)
    if isinstance(one, int | float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=SAME, abs_tol=_TINY)
    return bool(one == other)
