"""What a ``result.json`` keeps of its run: enough to do it again."""

from __future__ import annotations

import csv
import io
import json
import tempfile
from base64 import b64decode
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orthoglide.cli.kept_checks import check_arguments, check_inputs, check_name
from orthoglide.cli.options import noise_metres
from orthoglide.errors import FileError
from orthoglide.progress import Progress, Step

if TYPE_CHECKING:
    from orthoglide.machine import Machine
    from orthoglide.observations import Campaign
    from orthoglide.report import InputFile, Run

COMMANDS = ("identify", "close-loop", "diagnose", "demo")
"""Whose results can be run again."""


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
    except FileError:
        raise
    except (ValueError, RecursionError):  # a number of thousands of digits, or brackets as many
        raise FileError("is no result: give the result.json of a run", file=str(path)) from None
    told = found.get("arguments") if isinstance(found, dict) else None
    if isinstance(told, dict) and "fit_tcp" in told:
        raise FileError(
            "is of --fit-tcp, which keeps no rows: run that command again", file=str(path)
        )
    needed = ("schema", "version", "command", "arguments", "seed", "inputs", "machine")
    missing = [n for n in needed if not isinstance(found, dict) or n not in found]
    if missing:
        raise FileError(
            f"has no {missing[0]!r}: give the result.json of a run as it was written",
            file=str(path),
        )
    if found["schema"] != 1 or found["command"] not in COMMANDS:
        raise FileError(
            f"is of schema {found['schema']}, command {found['command']!r}: this version runs "
            f"schema 1 of {', '.join(COMMANDS)} again",
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
        from orthoglide.machine_file.posterior import parse_posterior
        from orthoglide.report import InputFile

        try:
            check_inputs(result["inputs"])
            inputs = tuple(
                InputFile(
                    i["file"], i["sha256"], tuple(i["rows"]),
                    i.get("role", "campaign"), tuple(i.get("lines", ())),
                )
                for i in result["inputs"]
            )  # fmt: skip
            told = result["machine"]
            if told["file"] is not None:
                check_name(told["file"])
            spec = parse_machine_file(told["toml"], told["file"] or "")
            spec = replace(spec, file=told["file"] or "", sha256=told["sha256"] or "")
            if told.get("npz"):
                content = b64decode(told["npz"], validate=True)
                spec = replace(spec, posterior=parse_posterior(content, spec.sha256, str(path)))
            seed = result["seed"]
            check_arguments(result["command"], result["arguments"], seed)
            noise_metres(result["arguments"]["noise_mm"])
        except FileError:  # of the machine file
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            reason = f"no {error}" if isinstance(error, KeyError) else str(error)
            raise FileError(
                f"is not as it was written ({reason}): take the original", file=str(path)
            ) from None
        return cls(result["command"], result["arguments"], seed, inputs, Machine(spec), str(path))

    def files(self, step: Progress, whole: bool) -> dict[str, str | bytes]:
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
        if not whole:
            return {"result.json": result_text(view, run)}
        return verdict_files(view, run, step)

    def _identified(self, run: Run, step: Progress) -> dict[str, str | bytes]:
        from orthoglide.fit import identify
        from orthoglide.report import identification_files

        campaigns, arguments = self._campaigns("campaign"), self.arguments
        step(Step("identifying", f"from {sum(map(len, campaigns))} readings"))
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
        return noise_metres(self.arguments["noise_mm"])

    def _run(self) -> Run:
        from orthoglide.cli import closing, identification
        from orthoglide.effects import BASE_FAMILIES
        from orthoglide.report import Run

        told = self.arguments
        machine = Path(told["machine"]) if told.get("machine") else None
        paths = tuple(Path(name) for name in told["campaigns"])
        own, noise = tuple(told["own"]), told["noise_mm"]
        if self.command == "identify":
            free = tuple(told["free"])
            free = () if free == tuple(BASE_FAMILIES) else free
            asked = identification.Asked(
                free, told["priors"], own, machine, told["reduced"], noise, self.seed
            )
            again = asked.command_line(paths)
        elif self.command == "demo":
            again = closing.demo_line(self.seed)
        else:
            held, points = (Path(told[k]) if told[k] else None for k in ("holdout", "tcp"))
            loop = closing.Asked(paths, held, points, own, machine, noise, self.seed)
            again = loop.command_line(self.command)
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
        try:
            yield path
        except FileError as error:  # the reader knows the passing file only
            raise FileError(error.reason, file=kept.file, line=error.line) from error


def input_text(kept: InputFile) -> str:
    """A file's rows as CSV, each on the line where it stood."""
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
