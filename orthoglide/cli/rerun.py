"""``rerun``: a result's numbers again, from the rows that it keeps."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

import orthoglide.cli.options as opt
from orthoglide.cli.progress import progress
from orthoglide.cli.terminal import say
from orthoglide.cli.writing import write_results
from orthoglide.errors import FileError, NumericsError
from orthoglide.progress import Step
from orthoglide.text import brief

SAME = 1e-6
"""Relative difference up to which numbers count as equal: other processors round otherwise."""

_TINY = 1e-9  # millimetres, or what else a number stands for: rounding of what should be zero
# What was given, how the numbers were found, and checks that measure rounding.
_APART = ("version", "inputs", "machine", "method", "verification", "calibrated_machine")
_OF_SOLVERS = ("iterations", "last_step_in_sigmas")  # of any fit
_FEW_SAID = 5

_WITHIN = 0.2
"""Sigmas by which a value may differ from an earlier version's: a tenth of the 95 % half width."""


@click.command()
@click.argument("result", type=opt.PATH, metavar="result.json")
@opt.out_or_nothing
@click.option(
    "--inputs",
    type=opt.PATH,
    metavar="FOLDER",
    help="Where the files lie that were read; else beside the result, or above it, or here.",
)
@opt.effects
@click.option("--quiet", is_flag=True, help="No progress; only what differs is said.")
def rerun(
    result: Path, out: Path | None, inputs: Path | None, effects_file: Path | None, quiet: bool
) -> None:
    """Do a run again from the rows kept in its result, and compare the numbers.

    Tells which of the files that were read have changed since. Exit code 0 where the numbers are
    the same, 3 where they are not.
    """
    from orthoglide.files import inside
    from orthoglide.result import read_result, request_of
    from orthoglide.result.reading import EDITED, as_edited

    result = inside(result, "result.json")
    old = read_result(result)
    with progress(quiet) as step:
        step(Step("reading"))
        from orthoglide.effects.loading import load_effects
        from orthoglide.report import report_files, result_text
        from orthoglide.verdict import run

        found = run(request_of(old, str(result), load_effects(effects_file)), step)
        files = report_files(found, step) if out is not None else {}
        new = json.loads(files.get("result.json") or result_text(found))
        older = not old.keys() >= new.keys()
        numbers = _numbers(new)
        folders = (inputs,) if inputs else (result.parent, result.parent.parent, Path())
        try:
            differences = list(_apart(old, new) if older else compare(_numbers(old), numbers))
            told = [line for line in input_lines(old, folders) if not quiet or "changed" in line]
        except EDITED as error:
            raise as_edited(error, str(result)) from None
        if older:
            version = brief(str(old["version"]))
            told.append(
                f"The result was made by an earlier state of version {version}, and this is "
                f"{new['version']}: verdict and values are compared, values to {_WITHIN:g} sigma."
            )
        if out is not None and not differences:
            write_results(out, files)
    if differences:
        if told:
            say("\n".join(told))
        few = "; ".join(differences[:_FEW_SAID])
        more = len(differences) - _FEW_SAID
        tail = f"; and {more} more" if more > 0 else ""
        raise NumericsError(
            f"{click.format_filename(result)} is not reproduced: {few}{tail}; nothing was written"
        )
    if not quiet:
        count = sum(1 for _ in leaves(new["parameters"] if older else numbers))
        told.append(f"The same numbers again: all {count} agree.")
        told += [] if out is None else [f"Report: {click.format_filename(out / 'report.html')}"]
    if told:
        say("\n".join(told))


def input_lines(result: Mapping[str, Any], folders: Sequence[Path]) -> Iterator[str]:
    """What became of the files that were read, a sentence each."""
    machine = result["machine"]
    given = [(i["file"], i["sha256"]) for i in result["inputs"]]
    if machine.get("file") and machine.get("sha256"):
        given.append((machine["file"], machine["sha256"]))
    for name, digest in (machine.get("urdf") or {}).items():
        if _digest(Path(name)) != digest:
            yield f"{name}: has changed since; the numbers are those of the file as it is now."
    packaged = result["command"] == "demo"
    for name, digest in () if packaged else given:
        path = next((f / name for f in folders if (f / name).is_file()), None)
        if path is None:
            yield f"{name}: not here; the rows kept in the result were used."
        elif _digest(path) == digest:
            yield f"{name}: unchanged."
        else:
            yield (
                f"{name}: has changed since; the rows kept in the result were used, not the file."
            )


def _digest(path: Path) -> str:
    """Of a file's content; empty where it cannot be read any more."""
    from orthoglide.files import read_bytes, sha256

    try:
        return sha256(read_bytes(path))
    except FileError:
        return ""


def _numbers(result: Mapping[str, Any]) -> dict[str, Any]:
    """What must be the same again to rounding."""
    return {k: v for k, v in result.items() if k not in _APART}


def _apart(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    """Yield a phrase for each difference in verdict or values, which count within tolerances."""
    verdicts = old.get("verdict"), new.get("verdict")
    if None not in verdicts and verdicts[0] != verdicts[1]:
        yield f"the verdict was {verdicts[0]!r} and is {verdicts[1]!r}"
    before, after = old.get("parameters") or {}, new.get("parameters") or {}
    for name in dict.fromkeys((*before, *after)):
        if name not in after or name not in before:
            yield f"{name} is {'gone' if name in before else 'new'}"
            continue
        one, other = before[name], after[name]
        limit = max(_WITHIN * one["sigma"], SAME * abs(one["value"]), _TINY)
        if not abs(one["value"] - other["value"]) <= limit:
            yield f"{name} was {one['value']:g} and is {other['value']:g} {one['unit']}"


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
    before, after = (
        {place: one for place, one in leaves(every) if not place.endswith(_OF_SOLVERS)}
        for every in (old, new)
    )
    for place in dict.fromkeys((*before, *after)):
        if place not in after:
            yield f"{place} was {_brief(before[place])} and is gone"
        elif place not in before:
            yield f"{place} is new, {_brief(after[place])}"
        elif not _same(before[place], after[place]):
            yield f"{place} was {_brief(before[place])} and is {_brief(after[place])}"


def _rounded_apart(one: float, other: float) -> bool:
    """Whether two numbers of six digits are neighbours: the same number rounded up and down."""
    if any(float(f"{v:.6g}") != v or v == 0 for v in (one, other)):
        return False
    digit = 10.0 ** (math.floor(math.log10(min(abs(one), abs(other)))) - 5)
    return abs(one - other) < 1.5 * digit


def _brief(value: Any) -> str:
    return repr(brief(value)) if isinstance(value, str) else brief(repr(value))


def _same(one: Any, other: Any) -> bool:
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in (one, other)):
        with suppress(OverflowError):  # of an integer beyond all that is calculated with
            near = math.isclose(one, other, rel_tol=SAME, abs_tol=_TINY)
            return near or _rounded_apart(float(one), float(other))
    return bool(one == other)
