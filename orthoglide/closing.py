"""Closing the loop: find what is left, trace it to a cause, add it, identify again, judge."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orthoglide.accuracy import tcp_map
from orthoglide.diagnosis.ranking import Diagnosis, budget, diagnose
from orthoglide.diagnosis.significance import Detection
from orthoglide.effects import Effect as Declared
from orthoglide.errors import InputError
from orthoglide.fit import (
    Estimate,
    Frame,
    Source,
    account_for_changes,
    assemble,
    identify,
    solve,
    sorted_out,
)
from orthoglide.fit.doubts import check_slips
from orthoglide.frames import html_table
from orthoglide.judging import fitted_already, hold_out, tcp_errors
from orthoglide.machine import Machine
from orthoglide.notes import Note
from orthoglide.observations import Given, TcpPoints, as_campaigns
from orthoglide.posterior import full_posterior
from orthoglide.progress import Progress, Step, silent
from orthoglide.request import Request
from orthoglide.result import Result, Word, by_lack_of_fit
from orthoglide.searching import DETECTION, NAMING, Effect, Search

__all__ = [
    "DETECTION",
    "NAMING",
    "Effect",
    "Verdict",
    "close_loop",
    "judge",
    "run",
]

SIGNIFICANT = 0.003
"""Probability of calling what is left significant, whatever its shape, where nothing is."""

SIGNIFICANT_AFTER = 0.01
"""The same once a cause is named, against noise alone."""


class Verdict(Result):
    """A result that writes and shows itself: what :func:`close_loop` returns."""

    def report(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the report into a folder, as the command line does.

        Args:
            folder: where to.
            overwrite: whether an earlier report there is replaced; the folder is new or empty
                otherwise.

        Raises:
            FileError: where the folder is not empty and not replaced, or cannot be written.
        """
        from orthoglide.report import write_report

        write_report(self, folder, overwrite=overwrite)

    def __repr__(self) -> str:
        found = ", ".join(e.name for e in self.effects) or "no cause"
        return f"<Verdict {self.word}: {found}; {self.request.command}>"

    def __str__(self) -> str:
        from orthoglide.report import summary

        return summary(self)

    def _repr_html_(self) -> str:
        from orthoglide.report.wording import headline

        return html_table(headline(self), self.columns)


def close_loop(
    campaigns: Source | Sequence[Source],
    machine: Machine | None = None,
    *,
    own: Sequence[str] = (),
    noise: float | None = None,
    holdout: Given | None = None,
    tcp: TcpPoints | None = None,
    effects: Sequence[Declared] = (),
    seed: int = 0,
    progress: Progress | None = None,
    frame: Frame = "rigid",
) -> Verdict:
    """Identify, ask what is left, trace it to a cause, add it, and judge.

    Args:
        campaigns: one or several, of dial readings (paths are read as by ``read_campaign``) or TCP
            points that are readings like the others.
        machine: dimensions, tolerances, dial; nominal where absent.
        own: effects or parameters that each campaign has for itself; the rest is shared.
        noise: standard deviation of one reading, metres.
        holdout: a campaign that only judges the finished result.
        tcp: measured points that only judge the finished result.
        effects: of one's own, weighed beside those of the machine's catalogue.
        seed: of every random draw; the same seed gives the same answer.
        progress: called with each step; any callable will do.
        frame: how the instrument of TCP points may stand to the machine.

    Raises:
        InputError: where the campaigns cannot be used.
        NumericsError: where the base model cannot be identified.
    """
    machine = (machine or Machine.nominal()).with_effects(effects)
    several, points = sorted_out(campaigns, machine)
    held = None if holdout is None else as_campaigns(holdout, machine.spec)[0]
    request = Request(
        "close-loop", several, machine, tuple(own), noise, seed, held, tcp, points=points,
        frame=frame,
    )  # fmt: skip
    return run(request, progress)


def run(request: Request, progress: Progress | None = None) -> Verdict:
    """Do what was asked: once, or again from the request that a result keeps.

    Args:
        request: what to do.
        progress: called with each step; any callable will do.

    Raises:
        InputError: where the campaigns cannot be used.
        NumericsError: where the base model cannot be identified.
    """
    progress = progress or silent
    if not request.searches:
        return _identified(request, progress)
    progress(Step("identifying", "joint offsets and leg lengths"))
    machine = request.machine
    carried = [name for name, entry in machine.spec.parameters.items() if entry.sigma > 0]
    problem = assemble(
        [*request.campaigns, *request.points], machine, (*machine.catalogue.base, *carried),
        own=request.own, noise=request.noise, frame=request.frame,
    )  # fmt: skip
    before = account_for_changes(solve(problem))
    check_slips(before)
    problem = before.problem
    from orthoglide.diagnosis.blunders import examine, without
    from orthoglide.diagnosis.changes import separated

    progress(Step("faults"))
    findings = examine(before)
    blunders, changes = findings.blunders, findings.changes
    faulty = before if blunders else None
    if blunders:
        problem = without(problem, blunders)
    # What a change put right is no cause now; what is still wrong is named as one.
    causes = [c for c in changes if c.is_cause and c.parameter not in before.names]
    if changes:
        problem = separated(problem, [c for c in changes if c not in causes])
        problem = replace(problem, own=(*problem.own, *(n for c in causes for n in c.own)))
    if blunders or changes:
        before = solve(problem)
    search = Search(problem, progress, np.random.default_rng([request.seed, 1]))
    search.changed = [c.parameter for c in causes]
    verdict = _search(request, search, before)
    since = tuple(c.now(verdict.after) for c in before.changes)
    changed = (*since, *(c.measured(verdict.after) for c in changes))
    progress(Step("judging"))
    return judge(replace(verdict, blunders=blunders, changed=changed, faulty=faulty))


def _identified(request: Request, progress: Progress) -> Verdict:
    """A closed loop in which no effect may be added."""
    count = sum(map(len, request.campaigns)) + sum(map(len, request.points))
    progress(Step("identifying", f"from {count} readings"))
    estimate = identify(
        [*request.campaigns, *request.points],
        request.machine,
        request.free,
        own=request.own,
        priors=request.priors,
        noise=request.noise,
        method="reduction" if request.reduced else "auto",
        frame=request.frame,
    )
    progress(Step("testing"))
    left = _left(estimate, request.seed)
    found = by_lack_of_fit(estimate) if left is None else left.detection
    stopped = "no cause was to be added"
    return Verdict(
        request, _word((), found), estimate, estimate, (), (), left, stopped,
        changed=estimate.changes,
    )  # fmt: skip


def judge(verdict: Verdict) -> Verdict:
    """Judge a finished verdict by what its request holds back; only the scores change."""
    request, machine = verdict.request, verdict.after.problem.machine
    before, after = verdict.values_before, verdict.values
    scored = errors = None
    if request.holdout is not None:
        scored = hold_out(before, after, machine, request.holdout, request.own)
        if any(fitted_already(request.holdout, c) for c in request.campaigns):
            text = "the readings held out are readings that were fitted: they judge nothing"
            warnings = (*verdict.after.warnings, Note(text, "holdout"))
            verdict = replace(verdict, after=replace(verdict.after, warnings=warnings))
    if request.tcp is not None:
        stated = tcp_map(verdict.machine, request.tcp.command).sigma
        errors = tcp_errors(machine, request.tcp, before, after, stated)
    return replace(verdict, hold_out=scored, tcp=errors)


def _search(request: Request, search: Search, before: Estimate) -> Verdict:
    after, left, stopped = search.run(before)
    search.progress(Step("allowing"))
    effects, tried = tuple(search.effects), tuple(search.tried)
    word, known = _word(effects, left.detection), full_posterior(after)
    return Verdict(request, word, before, after, effects, tried, left, stopped, known)


def _left(estimate: Estimate, seed: int) -> Diagnosis | None:
    """What a fit leaves, tested against the catalogue; ``None`` where all of it is free."""
    rng = np.random.default_rng([max(seed, 0), 1])
    try:
        return diagnose(estimate, max(budget(diagnose(estimate, 0, rng).signatures), 1), rng)
    except InputError:
        return None


def _word(effects: Sequence[Effect], test: Detection) -> Word:
    """The verdict. Lack of fit decides with the best of the catalogue: either is significant."""
    if not effects:
        significant = test.p_value < DETECTION or test.lack_of_fit_p < SIGNIFICANT
        return "unexplained" if significant else "adequate"
    # To call a machine explained takes more than to leave one alone: what the named cause does not
    # explain counts against noise alone.
    if test.p_value < DETECTION or test.bare_lack_of_fit_p < SIGNIFICANT_AFTER:
        return "partial"
    return "ambiguous" if any(e.different for e in effects) else "explained"
