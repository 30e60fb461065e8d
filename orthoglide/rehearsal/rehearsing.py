"""Rehearsing a sheet: campaigns on many drawn machines, side by side and resumable."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import get_args

from orthoglide import __version__
from orthoglide.arguments import public
from orthoglide.errors import FileError, InputError, NumericsError, check_integer
from orthoglide.files import as_file_errors, read_bytes, sha256, write_file
from orthoglide.instruments import LegDial, PlateTouch
from orthoglide.machine import Machine, MachineSource
from orthoglide.machine_file import machine_text
from orthoglide.observations import Readings, campaign_text, protocol, read_readings
from orthoglide.observations.protocols import ProtocolName
from orthoglide.planning import sheets_by_kind
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.rehearsal.outcome import Outcome, Rehearsal, Scope, check_tolerances, run_campaign
from orthoglide.result import decoded, encoded

CAMPAIGNS = 90
"""Ten times :data:`orthoglide.rehearsal.outcome.KIND_SEQUENCE`."""


@public
def rehearse(
    machine: MachineSource | None = None,
    sheet: Readings | str | os.PathLike[str] | None = None,
    campaigns: int = CAMPAIGNS,
    *,
    owns: Sequence[str] = (),
    seed: int = 0,
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Rehearsal:
    """Return how often a sheet would find what is wrong with machines like this one.

    Machines are drawn by dimensions and tolerances, measured by the sheet, and calibrated; the
    verdict is compared with the truth. The model that calibrates them also simulates them: a
    rehearsal cannot show errors that no model of the package has.

    Args:
        machine: dimensions, tolerances and instruments; nominal where absent. Its parameters do not
            count.
        sheet: rows to be read, as campaign, file or kind of protocol; readings do not count. Where
            absent the protocol sweep, or a probe on a plate where no dial stands on a leg.
        campaigns: how many; a larger rehearsal holds the smaller.
        owns: in place of a sheet, kinds of readings that are taken together, each by a sheet of its
            own: ``leg``, ``tcp``, ``plate``, ``distance``, ``ballbar``, ``incline``.
        seed: of every random draw; the same seed gives the same answer, whatever the jobs.
        jobs: processes, -1 for all processors; where absent as ``joblib.parallel_config`` says,
            which may be a cluster (``parallel_config(backend="dask")``), else one.
        out: folder for finished campaigns and the table: a run that was stopped goes on from there.
        progress: called with each step; any callable will do.

    Raises:
        InputError: for a machine or sheet that cannot be used, tolerances too large for the
            machine, or a folder of another rehearsal or of more campaigns.
        NumericsError: where a process is ended from outside.
    """
    progress = progress or no_progress
    campaigns, seed = check_integer("campaigns", campaigns, 1), check_integer("seed", seed, 0)
    if jobs == 0:
        raise InputError("jobs must be a number of processes, or -1 for all processors, not 0")
    machine = Machine.of(machine).with_only({})
    scope = Scope.of(machine, *_sheets_to_read(machine, sheet, owns))
    check_tolerances(scope)
    journal = None if out is None else _Journal(Path(out), scope, seed, campaigns)
    outcomes = _run_campaigns(scope, campaigns, seed, jobs, journal, progress)
    readings = sum(len(sheet) for sheet in scope.sheets)
    rehearsal = Rehearsal(machine.spec.title, readings, seed, outcomes)
    if out is not None:
        write_file(Path(out) / "rehearsal.txt", f"{rehearsal}\n", overwrite=True)
    return rehearsal


def _sheets_to_read(
    machine: Machine, sheet: Readings | str | os.PathLike[str] | None, owns: Sequence[str]
) -> tuple[Readings, ...]:
    if sheet is not None and owns:
        raise InputError("sheet and owns exclude each other: each instrument has its own sheet")
    if sheet is None:
        kinds = owns or ((LegDial.kind,) if machine.geometry.dialled else (PlateTouch.kind,))
        return tuple(sheets_by_kind(machine, kinds).values())
    if isinstance(sheet, Readings):
        return (sheet,)
    if sheet in get_args(ProtocolName):
        return (protocol(sheet, machine.geometry),)  # type: ignore[arg-type]
    return read_readings(sheet, machine.spec, require_readings=False)


def _run_campaigns(
    scope: Scope,
    campaigns: int,
    seed: int,
    jobs: int | None,
    journal: _Journal | None,
    progress: Progress,
) -> tuple[Outcome, ...]:
    """Return all campaigns in their order, those of an earlier run as they were."""
    from joblib import Parallel, delayed, effective_n_jobs

    outcomes = dict(journal.finished) if journal else {}
    pending = [k for k in range(campaigns) if k not in outcomes]

    def show() -> None:
        text = f"campaign {len(outcomes)} of {campaigns}"
        progress(Step("computing", text, 100 * len(outcomes) / campaigns))

    show()
    tasks = (delayed(run_campaign)(scope, k, seed) for k in pending)
    try:
        # joblib starts all its processes, whether or not there are tasks for them
        processes = min(effective_n_jobs(jobs), max(len(pending), 1))
        parallel = Parallel(n_jobs=processes, return_as="generator_unordered")
        for outcome in parallel(tasks) if pending else ():
            outcomes[outcome.number] = outcome
            if journal:
                journal.add(outcome)
            show()
    except BrokenExecutor as error:
        raise NumericsError(
            "a process of the rehearsal was ended from outside, perhaps for want of memory: give "
            "fewer jobs"
        ) from error
    return tuple(outcomes[k] for k in range(campaigns))


class _Journal:
    """The file of finished campaigns, from which a stopped run is resumed, in a folder that is new,
    empty, or of an earlier run.

    Its first line says what determines every campaign, files by their digests; then a campaign a
    line.

    Raises:
        FileError: if the folder contains something else, or campaigns of another rehearsal, or more
            of them.
    """

    def __init__(self, folder: Path, scope: Scope, seed: int, campaigns: int) -> None:
        self.path = folder / "campaigns.jsonl"
        machine = machine_text(scope.machine.spec) + " ".join(scope.machine.catalogue)
        request = {
            "the version of orthoglide": __version__,
            "the machine file": sha256(machine.encode()),
            "the sheet": sha256(campaign_text(scope.sheets, scope.machine.spec).encode()),
            "the seed": str(seed),
        }
        with as_file_errors(folder):
            folder.mkdir(exist_ok=True)
            if not self.path.exists() and any(folder.iterdir()):
                raise self._unusable("cannot be begun, as the folder holds no earlier rehearsal")
        if not self.path.exists():
            write_file(self.path, json.dumps(request) + "\n", overwrite=False)
        content = read_bytes(self.path)
        complete = content[: content.rfind(b"\n") + 1]
        try:
            stored_request, *records = map(json.loads, complete.decode().splitlines())
            differences = [k for k, v in request.items() if stored_request[k] != v]
            self.finished = {r["number"]: decoded(Outcome, r, {}) for r in records}
        except (ValueError, TypeError, KeyError, AttributeError):
            raise self._unusable("holds no campaigns of a rehearsal") from None
        if differences:
            verb = "is" if len(differences) == 1 else "are"
            reason = f"{' and '.join(differences)} {verb} not the same"
            raise self._unusable(f"holds campaigns of another rehearsal, as {reason}")
        if (count := max(self.finished, default=-1) + 1) > campaigns:
            raise self._unusable(f"holds {count} campaigns", f"ask for {count} or more, or ")
        if len(complete) < len(content):  # stopped while a line was written
            with as_file_errors(self.path):
                os.truncate(self.path, len(complete))

    def _unusable(self, problem: str, other_remedy: str = "") -> FileError:
        remedy = f"{other_remedy}name another folder"
        return FileError(f"{problem}: {remedy}", file=self.path)

    def add(self, outcome: Outcome) -> None:
        """Write one more outcome to the file, at once."""
        line = json.dumps(encoded(outcome), allow_nan=False) + "\n"
        with as_file_errors(self.path), self.path.open("a", encoding="utf-8") as file:
            file.write(line)
