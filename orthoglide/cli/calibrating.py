"""From readings to values and causes: ``demo``, ``close-loop``, ``check``, ``rerun`` and others."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import orthoglide.cli.options as opt
from orthoglide.cli.app import cli, deliver, progress, warn
from orthoglide.errors import InputError, NumericsError
from orthoglide.numerals import compact
from orthoglide.text import wrapped

if TYPE_CHECKING:
    from orthoglide.result import Command, Request
    from orthoglide.verdict import Verdict

_UNNAMED = Path("DIR")  # folder in advised commands where --out is absent
DEMO_FOLDER = "orthoglide-demo"
DEMO_CAMPAIGN, DEMO_SECOND, DEMO_MACHINE = "experiment2.csv", "experiment3.csv", "made-up.toml"

_RERUN_SIGMAS = 0.2
"""Sigmas by which a repeated value may differ: a tenth of the 95 % half width."""
_ROUNDING = 1e-6
"""Relative and, in the units of files, absolute difference that rounding explains."""

_json_option = click.option("--json", "as_json", is_flag=True, help="Print result.json only.")
_holdout_options = opt.combine_options(
    opt.file("--holdout", "Readings that only judge the finished result."),
    opt.file("--tcp", "Measured TCP points that only judge the finished result."),
)
_run_options = opt.combine_options(
    click.argument("campaigns", nargs=-1, type=opt.PATH),
    opt.machine(),
    opt.out(),
    opt.names("--own", "Effects or parameters with a separate value for each campaign."),
    opt.file("--fit-tcp", "TCP points that are readings like the others; may be given several "
             "times.", multiple=True),
    click.option("--frame", type=click.Choice(("rigid", "translation", "none")), default="rigid",
                 show_default=True,
                 help="Motion of the frame of --fit-tcp that is fitted."),
    opt.noise("from machine file, rows or repeats"),
    opt.seed,
    opt.quiet,
    _json_option,
)  # fmt: skip


@cli.command()
@opt.out(f"Folder for the results.  [default: {DEMO_FOLDER}]")
@opt.seed
@opt.quiet
@_json_option
def demo(out: Path | None, seed: int, quiet: bool, as_json: bool) -> None:
    """Close the loop on the published Orthoglide (2008), and on a machine with a known fault.

    The first machine is that of the papers, from its authors' own readings: what offsets and
    lengths leave, the effects that may be behind it, the error before and after each is added, and
    what would decide between them. The second is made up, so that its fault is known: its dials
    are simulated over a whole sweep, and the fault is found.

    \b
    Example:
      orthoglide demo --out demo
    """
    from orthoglide.report import report_files
    from orthoglide.report.rows import possible_cause_sentences
    from orthoglide.text import sentence
    from orthoglide.verdict import run

    numbered = (Path(f"{DEMO_FOLDER}-{number}") for number in count(2))
    folder = out or next(p for p in chain([Path(DEMO_FOLDER)], numbered) if not p.exists())
    with_paths = opt.MachineOption(None, None).with_typed_paths
    files, answers, results = dict[str, str | bytes](), list[str](), dict[str, Any]()
    for name, (intro, request) in _demo_requests(seed, files).items():
        with progress(quiet or as_json) as step:
            result = run(request, step)
            report = report_files(result, step)
        files |= {f"{name}/{file}": content for file, content in report.items()}
        results[name] = json.loads(report["result.json"])
        lines = [intro, f"Verdict {result.word}: {results[name]['summary']}"]
        lines += [f"Possible cause: {text}" for text in possible_cause_sentences(result)]
        lines += [
            f"What to do: {with_paths(sentence(action.words), folder / name)}"
            for action in result.actions
        ]
        lines += [_report_line(folder / name), ""]
        answers.append(f"{name}: {result.word}" if quiet else "\n".join(lines))
    answer = (", " if quiet else "\n").join(answers).rstrip("\n")
    deliver(json.dumps(results, indent=1, ensure_ascii=False) if as_json else answer, files, folder)


def _report_line(folder: Path, page: str = "report.html") -> str:
    return f"Report: {click.format_filename(folder / page)}"


def _demo_requests(seed: int, files: dict[str, str | bytes]) -> dict[str, tuple[str, Request]]:
    """Return an introduction and the request of each run by name; their input joins ``files``."""
    from importlib.resources import as_file, files as packaged
    from tempfile import TemporaryDirectory

    from orthoglide.effects.wording import cause_words
    from orthoglide.machine import Machine
    from orthoglide.observations import campaign_text
    from orthoglide.simulation import simulate
    from orthoglide.verdict import build_request

    with as_file(packaged("orthoglide") / "data") as data:
        worn = Machine.load(data / DEMO_MACHINE)
        files[DEMO_MACHINE] = (data / DEMO_MACHINE).read_text("utf-8")
        published = build_request(
            (data / DEMO_CAMPAIGN, data / DEMO_SECOND), own=worn.catalogue.correctable_by("zero"),
            seed=seed, command="demo",
        )  # fmt: skip
    (fault,) = (name for name in worn.values if worn.catalogue.effect_of(name).name not in
                worn.catalogue.base)  # fmt: skip
    campaign = simulate(worn, "sweep", seed=seed)
    with TemporaryDirectory() as temporary:
        sheet = Path(temporary) / "simulated.csv"
        sheet.write_text(campaign_text(campaign, worn.spec), encoding="utf-8")
        files[sheet.name] = sheet.read_text("utf-8")
        simulated = build_request(sheet, seed=seed)
    hidden = cause_words(worn.catalogue, fault, worn.values)
    return {
        "published": (
            "1. The machine of the papers, from the 24 averages that its authors published, each "
            "counted from the zero posture: Experiments 2 and 3, between which new offsets were "
            "set.",
            published,
        ),
        "simulated": (
            f"2. A machine made up, so that its fault is known: {hidden}. {len(campaign)} readings "
            f"of a whole sweep were simulated and nothing else was given.",
            simulated,
        ),
    }


@cli.command("close-loop")
@_run_options
@_holdout_options
def close_loop(**options: Any) -> None:
    """Calibrate, search for the causes of the residual, and write the report.

    \b
    Examples:
      orthoglide close-loop april.csv --machine machine.toml --out april
      orthoglide close-loop april.csv may.csv --holdout june.csv --out spring
    """
    _run("close-loop", **options)


@cli.command()
@_run_options
@_holdout_options
def diagnose(**options: Any) -> None:
    """Print the verdict of close-loop and the causes with the most evidence.

    \b
    Example:
      orthoglide diagnose april.csv --machine machine.toml
    """
    _run("diagnose", **options)


@cli.command()
@_run_options
@opt.names("--free", "Effects or parameters to identify.  [default: joint offsets and leg lengths]")
@opt.flag("--no-priors", "Do not use the tolerances as priors.")
@opt.flag("--reduced", "Identify with the analytic reduction.")
def identify(free: tuple[str, ...], no_priors: bool, reduced: bool, **options: Any) -> None:
    """Identify joint offsets and leg lengths (or more) from campaigns of dial readings.

    \b
    Examples:
      orthoglide identify april.csv --out april
      orthoglide identify april.csv --fit-tcp tracker.tcp.csv --noise 0.004 --out spring
    """
    options |= {"free": free} if free else {}
    _run("identify", **options, priors=not no_priors, reduced=reduced)


def _run(
    command: Command, *, campaigns: tuple[Path, ...], machine: opt.MachineOption, out: Path | None,
    fit_tcp: tuple[Path, ...], quiet: bool, as_json: bool, **options: Any,
) -> None:  # fmt: skip
    """Run a request, write its folder if there is one, and print the result."""
    if not campaigns and not fit_tcp:
        raise InputError("name at least one campaign, or TCP points with --fit-tcp")
    with progress(quiet or as_json) as step:
        from orthoglide.observations import read_tcp
        from orthoglide.report import report_files, result_text
        from orthoglide.text import printable_path
        from orthoglide.verdict import build_request, run

        robot = machine.load(doubts=False)
        tcp_points = (read_tcp(path, robot.spec) for path in fit_tcp)
        name = printable_path(machine.effects_file.name) if machine.effects_file else ""
        options |= {"command": command, "effects_file": name}
        result = run(build_request((*campaigns, *tcp_points), robot, **options), step)
        files = {} if out is None else report_files(result, step)
        answer = _answer(result, machine, out, quiet)
        if as_json:
            answer = result_text(result).rstrip("\n")
    deliver(answer, files, out)


def _answer(result: Verdict, machine: opt.MachineOption, out: Path | None, quiet: bool) -> str:
    """Return the text of a result for the terminal, with the place of its files."""
    from orthoglide.report import summary
    from orthoglide.report.sentences import meaning

    if quiet:
        return f"Verdict {result.word}: {meaning(result)}."
    folder, ranked = out or _UNNAMED, result.request.command == "diagnose"
    text = summary(result, ranked, "machine", lambda line: machine.with_typed_paths(line, folder))
    return _with_files(text, out, "report.html")


def _with_files(text: str, out: Path | None, page: str) -> str:
    """Return a text with the place of the page, or of the calibrated machine that it mentions."""
    if out is not None:
        return f"{text}\n\n{_report_line(out, page)}"
    file = f"{_UNNAMED / opt.CALIBRATED}"
    return text + (f"\n({file} is written with --out {_UNNAMED}.)" if file in text else "")


@cli.command()
@click.argument("states", nargs=-1, type=opt.PATH, metavar="OLD NEW")
@opt.machine()
@opt.out("Folder for the report; nothing is written if absent.")
@opt.noise("that of the results, or from machine file, rows or repeats")
@opt.seed
@opt.quiet
def check(
    states: tuple[Path, ...], machine: opt.MachineOption, out: Path | None, noise: float | None,
    seed: int, quiet: bool,
) -> None:  # fmt: skip
    """Report what changed between two states of a machine: after a repair, or a year.

    OLD and NEW are campaigns, or results (their folder or result.json), of which the readings and
    the noise are taken.

    \b
    Examples:
      orthoglide check before.csv after.csv --machine machine.toml
      orthoglide check april/result.json after.csv --out repaired
    """
    if len(states) != 2:
        raise InputError(
            f"give OLD and NEW, two campaigns or results, not {len(states)}; a machine file has no "
            f"readings: give the result.json beside it"
        )
    with progress(quiet) as step:
        from orthoglide.checking import check as compare, read_states
        from orthoglide.checking.pages import changes_text, check_files
        from orthoglide.observations.tables import copied_files

        robot = None if machine.path is None else machine.read()
        old, new = read_states(states[0], states[1], robot, machine.effects)
        if robot is not None:
            opt.warn_of(new.machine)  # which is used without what a calibration found
        changes = compare(old, new, noise=noise, seed=seed, progress=step)
        files = {} if out is None else check_files(changes, step)
        text = machine.with_typed_paths(changes_text(changes), out or _UNNAMED)
        answer = changes.line if quiet else _with_files(wrapped(text), out, "check.html")
    warn(copied_files((*old.given, *new.given)))
    deliver(answer, files, out)


@cli.command()
@click.argument("result", type=opt.PATH, metavar="result.json")
@opt.file("--effects-file", "Python file with effects of your own, if the run had some.", "FILE.py")
@opt.out("Folder for the new report; nothing is written if absent.")
@opt.quiet
def rerun(result: Path, effects_file: Path | None, out: Path | None, quiet: bool) -> None:
    """Repeat a run from the rows kept in its result, and compare verdict and values.

    Exit code 0 if they are equal to rounding, or to 0.2 sigma if another version of the program
    wrote the result; 3 if they are not.

    \b
    Examples:
      orthoglide rerun april/result.json
      orthoglide rerun april --out again
    """
    with progress(quiet) as step:
        from orthoglide.files import result_file
        from orthoglide.report import report_files, result_text
        from orthoglide.result import read_result, request_of
        from orthoglide.result.request import EDITED_FILE_ERRORS, edited_file_error, version_text
        from orthoglide.verdict import run

        file = result_file(result, "result.json")
        old = read_result(file)
        effects = opt.MachineOption(None, effects_file).effects
        verdict = run(request_of(old, str(file), effects), step)
        new = json.loads(result_text(verdict))
        try:
            sigmas, different = _allowed_sigmas(old, new), list(differences(old, new))
        except EDITED_FILE_ERRORS as error:
            raise edited_file_error(error, str(file)) from None
        files = {} if out is None or different else report_files(verdict, step)
    if different:
        finding = "is not reproduced"
        if sigmas:
            inputs = ", ".join(dict.fromkeys(readings["file"] for readings in old["inputs"]))
            finding += (
                f" by this state of the program; {version_text(old)} wrote it: keep it as a "
                f"record, and give {inputs} to orthoglide {old['command']} for the numbers of today"
            )
        raise NumericsError(f"{click.format_filename(file)} {finding}: {'; '.join(different)}")
    total = len(new["parameters"])
    answer = f"The same numbers again, from the rows kept in the result: all {total} agree"
    if sigmas:
        answer += (
            f" to {sigmas:g} sigma, as an earlier state of the program, {version_text(old)}, "
            f"wrote the result"
        )
    answer += "." if out is None or quiet else f".\n{_report_line(out)}"
    deliver(answer, files, out)


def _allowed_sigmas(old: Mapping[str, Any], new: Mapping[str, Any]) -> float:
    """Return the sigmas by which values may differ: zero if the same program wrote both."""
    return 0.0 if old["version"] == new["version"] and old.keys() >= new.keys() else _RERUN_SIGMAS


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    """Yield a phrase for each difference between two ``result.json`` in verdict or values."""
    if old.get("verdict") not in (None, new["verdict"]):
        yield f"the verdict was {str(old['verdict'])[:40]!r} and is {new['verdict']!r}"
    sigmas = _allowed_sigmas(old, new)
    before, after = old["parameters"], new["parameters"]
    for name in dict.fromkeys((*before, *after)):
        if name not in after or name not in before:
            yield f"{name[:40]} is {'gone' if name in before else 'new'}"
            continue
        old_value, new_value = before[name]["value"], after[name]["value"]
        limit = max(sigmas * before[name]["sigma"], _ROUNDING * max(1.0, abs(old_value)))
        if not abs(old_value - new_value) <= limit:
            values = f"{compact(old_value, 6)} and is {compact(new_value, 6)}"
            yield f"{name} was {values} {before[name]['unit']}"
