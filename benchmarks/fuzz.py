"""Thousands of spoilt inputs through the command line: how does it end?

    python benchmarks/fuzz.py [--count 1000] [--seed 0] [--only rerun]
    python benchmarks/fuzz.py --case 4711 --keep FOLDER      one case again, its files kept

Each case is drawn from its own number: files of readings, TCP points, machine files and results are
changed where their structure lets something happen, then one command reads them. A run has to end
within ten seconds of its processor's time with exit code 0, 2 or 3; where it is not 0 with one
sentence and nothing left behind, where it is 0 with results that can be read. Whatever else
happens is printed with the number of its case. One in fifty is a verdict on readings of a known
machine, most of them moved: false ones are counted by kind (``fuzz_verdicts.py``).
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from types import FrameType
from xml.etree import ElementTree as ET

sys.path.insert(0, str(Path(__file__).parents[1]))

from click.testing import CliRunner, Result

from benchmarks.fuzz_mutations import spoil_json, spoil_lines, spoil_table
from benchmarks.fuzz_originals import originals
from benchmarks.fuzz_printers import misread
from benchmarks.fuzz_verdicts import Judged, judged, report
from benchmarks.public import command_line
from benchmarks.runs import show

LIMIT = 10.0
"""Seconds of processor time that a small input may take."""

_A_VERDICT, _SAID = 50, 500  # inputs to one verdict, and to a line of what was found so far
_CODES = (0, 2, 3)
_FAULT = "failed unexpectedly"


class Late(BaseException):
    """A run that does not end."""


@dataclass(frozen=True)
class Case:
    """One spoilt input.

    Attributes:
        number: that it was drawn from.
        files: content by name.
        arguments: of the command line.
    """

    number: int
    files: Mapping[str, bytes]
    arguments: tuple[str, ...]


# command: share, files that it reads (kind by name), what may follow
COMMANDS: dict[str, tuple[int, dict[str, str], tuple[str, ...]]] = {
    "identify": (8, {"a.csv": "small"}, ("--out", "out")),
    "identify published": (2, {"a.csv": "campaign"}, ("--out", "out", "--quiet")),
    "identify two": (2, {"a.csv": "small", "b.csv": "small"}, ("--own", "joint_offset", "--out",
    "out")),
    "identify points": (4, {"--fit-tcp": "tcp"}, ("--out", "out")),
    "identify by": (4, {"a.csv": "small", "--machine": "machine"}, ("--out", "out")),
    "diagnose": (4, {"a.csv": "small", "--tcp": "tcp"}, ("--json",)),
    "diagnose simulated": (3, {"a.csv": "simulated", "--machine": "machine"}, ("--quiet",)),
    "close-loop": (2, {"a.csv": "campaign", "--holdout": "small"}, ("--out", "out")),
    "rerun": (4, {"r.json": "result"}, ()),
    "rerun again": (2, {"r.json": "result"}, ("--out", "out")),
    "forward": (4, {"--csv": "rho"}, ("--out", "out")),
    "inverse": (3, {"--csv": "path", "--machine": "machine"}, ("--out", "out")),
    "compensate": (4, {"p.csv": "path", "--machine": "machine"}, ("--out", "out")),
    "simulate": (5, {"--machine": "machine"}, ("--out", "out", "--tcp", "out.tcp.csv")),
    "export": (2, {"--machine": "machine"}, ("--out", "out", "--force")),
    "import klipper": (3, {"printer.cfg": "printer"}, ("--out", "out")),
    "import klipper calibrated": (2, {"printer.cfg": "calibrated printer"}, ("--out", "out")),
    "identify mesh": (3, {"mesh.csv": "mesh", "--machine": "delta"}, ("--out", "out")),
    "forward delta": (1, {"--csv": "travel", "--machine": "delta"}, ("--out", "out")),
    "forward legs": (2, {"--csv": "travel of legs", "--machine": "legs"}, ("--out", "out")),
    "inverse legs": (1, {"--csv": "path", "--machine": "legs"}, ("--out", "out")),
    "identify tool": (4, {"tool.csv": "tool", "--machine": "legs"}, ("--out", "out")),
    "diagnose tool": (2, {"tool.csv": "tool", "--machine": "legs"}, ("--json",)),
    "check": (3, {"a.csv": "small", "b.csv": "small"}, ("--out", "out")),
    "check results": (2, {"a.json": "result", "b.csv": "small"}, ("--quiet",)),
    "design sheet": (2, {"sheet.csv": "sheet", "--machine": "machine"}, ("--quiet",)),
    "view": (2, {"m.toml": "legs"}, ("--out", "out")),
    "protocol": (2, {"--machine": "machine"}, ("--out", "out")),
}  # fmt: skip
_SLOW = (
    "identify published",
    "identify two",
    "diagnose",
    "diagnose simulated",
    "close-loop",
    "diagnose tool",
    "design sheet",
)
_LINES = ("machine", "delta", "legs", "printer", "calibrated printer")
_SPOIL = {"result": spoil_json} | dict.fromkeys(_LINES, spoil_lines)


def draw_case(number: int, only: str = "", light: bool = False) -> Case:
    """The case of a number; ``only`` of one command, or of those that take no second."""
    draw = Random(number)
    names = [n for n in COMMANDS if n.startswith(only) and not (light and n in _SLOW)]
    name = draw.choices(names, [COMMANDS[n][0] for n in names])[0]
    _, given, options = COMMANDS[name]
    spoilt = draw.choice(list(given))
    contents, arguments = dict[str, bytes](), [name.split()[0]]
    if arguments == ["import"]:
        arguments = name.split()[:2]
    for k, (place, kind) in enumerate(given.items()):
        text = originals()[kind]
        spoil = _SPOIL.get(kind, spoil_table)
        change = place == spoilt or draw.random() < 0.2
        file = place if not place.startswith("--") else f"given{k}"
        contents[file] = spoil(draw, text) if change else text.encode()
        arguments += [file] if file == place else [place, file]
    return Case(number, contents, (*arguments, *options))


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """`Late` where what is within takes longer, of the processor's time."""

    def late(_: int, frame: FrameType | None) -> None:
        raise Late(f"{seconds:g} s, at {traceback.format_stack(frame)[-1].strip()}")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def run_case(case: Case, folder: Path) -> tuple[str, int]:
    """What is wrong with how a case ends in an empty folder, if anything, and its exit code."""
    here = Path.cwd()
    os.environ["ORTHOGLIDE_TRACEBACK"] = "1"
    for name, content in case.files.items():
        (folder / name).write_bytes(content)
    os.chdir(folder)
    try:
        with limited(LIMIT):
            result = CliRunner().invoke(command_line(), case.arguments)
        return promised(case, result), result.exit_code
    except Late as late:
        return f"takes longer than {late}", -1
    finally:
        os.chdir(here)
        os.environ.pop("ORTHOGLIDE_TRACEBACK")


def promised(case: Case, result: Result) -> str:
    """The promise that an ended run breaks, in its folder."""
    error = result.exception
    if error is not None and not isinstance(error, SystemExit):
        where = traceback.extract_tb(error.__traceback__)[-1]
        name = Path(where.filename).name
        return f"{type(error).__name__}: {str(error)[:100]} ({name}, line {where.lineno})"
    new = sorted(set(os.listdir()) - set(case.files))
    if result.exit_code not in _CODES:
        return f"exit code {result.exit_code}"
    if result.exit_code:
        told = result.stderr.splitlines()[-1:]
        if new:
            return f"leaves {', '.join(new)} behind with exit code {result.exit_code}"
        if not told or not told[0].startswith("orthoglide: ") or _FAULT in told[0]:
            return f"says {told}"
        return "tells a page" if len(told[0]) > 1100 else ""
    if any(name.startswith(".") for name in new):
        return "leaves a temporary file behind"
    told = ""
    if case.arguments[0] == "import":
        told = misread(case.files["printer.cfg"], Path("out"), result.output)
    if told:
        return told
    return unreadable(Path("out")) if "--out" in case.arguments else ""


def unreadable(out: Path) -> str:
    """The first file of a result that cannot be read."""

    def strict(constant: str) -> None:
        raise ValueError(constant)

    for path in sorted([out, *out.rglob("*")] if out.is_dir() else [out]):
        try:
            if path.suffix == ".json":
                json.loads(path.read_text(encoding="utf-8"), parse_constant=strict)
            elif path.suffix in (".svg", ".urdf"):
                ET.fromstring(path.read_text(encoding="utf-8"))
            elif path.suffix == ".csv":
                with path.open(newline="", encoding="utf-8") as stream:
                    list(csv.reader(stream, strict=True))
        except (ValueError, ET.ParseError, csv.Error) as error:
            return f"{path.name} cannot be read: {error}"
    return "" if out.exists() else "writes nothing"


def main() -> None:
    """Run cases and print what is found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000, help="of cases")
    parser.add_argument("--seed", type=int, default=0, help="number of the first")
    parser.add_argument("--only", default="", help="one command")
    parser.add_argument("--case", type=int, help="this number alone")
    parser.add_argument("--keep", type=Path, help="folder for the files of the case")
    given = parser.parse_args()
    numbers = range(given.seed, given.seed + given.count) if given.case is None else [given.case]
    found, began, verdicts = Counter[str](), time.monotonic(), list[Judged]()
    for number in numbers:
        case = draw_case(number, given.only)
        with tempfile.TemporaryDirectory() as folder:
            wrong, code = run_case(case, Path(folder))
            if given.keep is not None:
                shutil.copytree(folder, given.keep)
        found["wrong" if wrong else f"exit code {code}"] += 1
        if wrong or given.case is not None:
            print(f"{number}: {' '.join(case.arguments)}: {wrong or 'as promised'}", flush=True)
        if given.case is None and not given.only and number % _A_VERDICT == 0:
            verdicts.append(judged(number // _A_VERDICT))
            if verdicts[-1].false:
                print(f"verdict {verdicts[-1]}", flush=True)
        if (done := sum(found.values())) % _SAID == 0:
            print(f"{done} cases: {dict(found)}", flush=True)
    spent = time.monotonic() - began
    print(f"{sum(found.values())} cases from {given.seed} on in {spent:.0f} s: {dict(found)}")
    show([report(verdicts)])
    sys.exit(1 if found["wrong"] or any(v.false for v in verdicts) else 0)


if __name__ == "__main__":
    main()
