"""Rehearsing a sheet: campaigns on many drawn machines, side by side and resumable."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import get_args

from orthoglide.errors import InputError, NumericsError, check_integer
from orthoglide.instruments import LegDial, PlateTouch
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings, protocol, read_readings
from orthoglide.observations.protocols import ProtocolName
from orthoglide.planning import aliasing, detectable_rows, sheets_by_kind, smallest_effects
from orthoglide.progress import Progress, Step, no_progress
from orthoglide.rehearsal.journal import Journal, request_digests
from orthoglide.rehearsal.outcome import Outcome, run_campaign
from orthoglide.rehearsal.random_machines import Scope
from orthoglide.rehearsal.table import Rehearsal
from orthoglide.simulation import missing_conditions

CAMPAIGNS = 90
"""Ten of each turn of :data:`orthoglide.rehearsal.random_machines.TURNS`."""

WEAK_TOLERANCES = 3.0
"""Tolerances: an effect that must be larger to be found, or named, is a weak spot of the sheet."""


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

    Machines are drawn by dimensions and tolerances, measured by the sheet, and calibrated from what
    was measured; what is then said is held against what is true. They are simulated by the model
    that calibrates them: what no model of the package has, no rehearsal shows.

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
        InputError: for a machine or sheet that cannot be used, or a folder of another rehearsal or
            of more campaigns.
        NumericsError: where a process is ended from outside.
    """
    progress = progress or no_progress
    campaigns, seed = check_integer("campaigns", campaigns, 1), check_integer("seed", seed, 0)
    if jobs == 0:
        raise InputError("jobs must be a number of processes, or -1 for all processors, not 0")
    machine = Machine.of(machine).with_only({})
    progress(Step("computing", "what the sheet can see"))
    scope = Scope.of(machine, *_sheets_to_read(machine, sheet, owns))
    kept = None if out is None else Journal(Path(out), request_digests(scope, seed), campaigns)
    weak = weak_spots(scope, seed)
    tried = _run_campaigns(scope, campaigns, seed, jobs, kept, progress)
    readings = sum(len(sheet) for sheet in scope.sheets)
    found = Rehearsal(machine.spec.title, readings, seed, tried, weak)
    if kept is not None:
        kept.conclude(f"{found}\n")
    return found


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


def weak_spots(scope: Scope, seed: int = 0) -> tuple[str, ...]:
    """Return rows of text: effects that are found or named from more than three tolerances only,
    those that the sheet cannot show, each with the reason, and waves that it takes for a curve.

    Sizes are those found, or named, with 95 % probability on a machine on which nothing else is
    wrong.
    """
    machine, catalogue = scope.machine, scope.machine.catalogue
    seen = smallest_effects(machine, scope.sheets, seed=seed)
    names = (*seen.invisible, *(s.name for s in seen.smallest if s.elementary))
    judged = {*catalogue.base, *(catalogue.effect_of(name).name for name in names)}
    dials = any(sheet.on_legs.any() for sheet in scope.sheets)
    missing: dict[str, list[str]] = {}
    for effect in catalogue.values():
        of_others = effect.instead_of or effect.of_body or (effect.of_dial and not dials)
        if effect.name not in judged and not of_others:
            missing.setdefault(missing_conditions(effect.needs), []).append(effect.name)
    return (
        *detectable_rows(seen, WEAK_TOLERANCES),
        *(f"not shown, as {reason}: {', '.join(effects)}" for reason, effects in missing.items()),
        *(warning for sheet in scope.sheets for warning in aliasing(machine, sheet)),
    )


def _run_campaigns(
    scope: Scope, campaigns: int, seed: int, jobs: int | None, kept: Journal | None, show: Progress
) -> tuple[Outcome, ...]:
    """Return all campaigns in their order, those of an earlier run as they were."""
    from joblib import Parallel, delayed

    done = dict(kept.finished) if kept else {}
    missing, began = [k for k in range(campaigns) if k not in done], time.monotonic()
    before = campaigns - len(missing)

    def progress(fresh: int) -> None:
        count, text = before + fresh, f"campaign {before + fresh} of {campaigns}"
        if fresh and count < campaigns:
            rest = (campaigns - count) * (time.monotonic() - began) / fresh
            text += f", about {rest:.0f} s left" if rest < 90 else f", {rest / 60:.0f} min left"
        show(Step("computing", text, 100 * count / campaigns))

    progress(0)
    tasks = (delayed(run_campaign)(scope, k, seed) for k in missing)
    try:
        parallel = Parallel(n_jobs=jobs, return_as="generator_unordered")
        for fresh, tried in enumerate(parallel(tasks) if missing else (), start=1):
            done[tried.number] = tried
            if kept:
                kept.add(tried)
            progress(fresh)
    except BrokenExecutor as error:
        raise NumericsError(
            "a process of the rehearsal was ended from outside, perhaps for want of memory: give "
            "fewer jobs"
        ) from error
    return tuple(done[k] for k in range(campaigns))
