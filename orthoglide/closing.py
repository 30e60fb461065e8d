"""Closing the loop: find what is left, trace it to a cause, add it, identify again, judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from orthoglide.accuracy import Knowledge, Map, knowledge, tcp_map
from orthoglide.diagnosis.ranking import Round
from orthoglide.effects import BASE_FAMILIES, MACHINE_PARAMETERS, is_dial
from orthoglide.fit import Estimate, build_problem, noise_of, solve
from orthoglide.judging import HoldOut, TcpErrors, hold_out, tcp_errors
from orthoglide.machine import Machine
from orthoglide.observations import Campaign, Given, TcpPoints, as_campaigns
from orthoglide.progress import Progress, Step, silent
from orthoglide.searching import DETECTION, NAMING, Effect, Search, Tried

__all__ = ["DETECTION", "LACK", "NAMING", "Effect", "Tried", "Verdict", "close_loop", "judge"]

Word = Literal["adequate", "explained", "ambiguous", "partial", "unexplained"]
LACK = 0.003
"""Probability of calling what is left significant, whatever its shape, where nothing is."""

LACK_AFTER = 0.01
"""The same once a cause is named, against noise alone."""


@dataclass(frozen=True)
class Verdict:
    """What closing the loop found.

    Attributes:
        word: adequate, explained, ambiguous, partial or unexplained.
        base: fit of joint offsets and leg lengths.
        fit: fit with the effects added.
        effects: in the order in which they were added.
        tried: all candidates that were identified.
        left: what the last fit leaves.
        stopped: why no further effect was added, in a sentence.
        known: what the readings say with everything else allowed.
        own: what each campaign has for itself.
        blunders: faults of the data, found before any physics.
        changed: parameters that are not the same in all campaigns, found before any physics.
        faulty: the base fit with the faulty readings in, where there are any.
        hold_out: scores on readings held out, or ``None``.
        tcp: errors at measured TCP points by alignment, or ``None``.
        seed: of every random draw.
        judges: the campaign held out and the TCP points, where there are any.
    """

    word: Word
    base: Estimate
    fit: Estimate
    effects: tuple[Effect, ...]
    tried: tuple[Tried, ...]
    left: Round
    stopped: str
    known: Knowledge
    own: tuple[str, ...] = ()
    blunders: tuple[Any, ...] = ()
    changed: tuple[Any, ...] = ()
    faulty: Estimate | None = None
    hold_out: HoldOut | None = None
    tcp: dict[str, TcpErrors] | None = None
    seed: int = 0
    judges: tuple[Campaign | None, TcpPoints | None] = (None, None)

    @cached_property
    def spread(self) -> tuple[tuple[float, dict[str, float]], ...]:
        """Weights and parameters of the explanations that fit as well, the chosen one left out."""
        found = []
        for effect in self.effects:
            total = effect.probability + sum(r.weight for r in effect.rivals)
            for rival in effect.rivals:
                estimate = rival.trial.estimate
                values = estimate.problem.values(len(estimate.problem.campaigns) - 1, estimate.x)
                found.append((rival.weight / total, values))
        return tuple(found)

    @cached_property
    def chosen(self) -> dict[str, float]:
        """Parameters of the explanation that was chosen, SI."""
        return self.fit.problem.values(len(self.fit.problem.campaigns) - 1, self.fit.x)

    @cached_property
    def explanations(self) -> tuple[tuple[float, dict[str, float]], ...]:
        """Weights and parameters of all explanations that fit as well, the chosen one first."""
        rest = max(1.0 - sum(share for share, _ in self.spread), 0.0)
        return ((rest, self.chosen), *self.spread)

    @cached_property
    def values(self) -> dict[str, float]:
        """Parameters of the calibrated machine, SI: averaged over what fits as well."""
        own = self.chosen
        averaged = dict(own)
        for weight, other in self.spread:
            for name in dict.fromkeys((*own, *other)):
                change = other.get(name, 0.0) - own.get(name, 0.0)
                averaged[name] = averaged.get(name, 0.0) + weight * change
        return {n: v for n, v in averaged.items() if not is_dial(n)}

    @property
    def before(self) -> dict[str, float]:
        """Parameters of the base model, SI."""
        return self.base.problem.values(len(self.base.problem.campaigns) - 1, self.base.x)

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine, sigmas of the second kind."""
        return self.fit.problem.machine.with_only(self.values, self._sigmas())

    def _sigmas(self) -> dict[str, float]:
        """Sigmas of the second kind of the machine's parameters, what fits as well in them."""
        weights, mean = self.known.weights, self.values
        variance = np.einsum("pe,ef,pf->p", weights, self.known.covariance, weights)
        variance += (weights @ self.known.shift) ** 2
        for share, other in self.explanations:
            apart = [other.get(n, 0.0) - mean.get(n, 0.0) for n in MACHINE_PARAMETERS]
            variance += share * np.square(apart)
        return dict(zip(MACHINE_PARAMETERS, np.sqrt(variance).tolist(), strict=True))

    @cached_property
    def map(self) -> Map:
        """Predicted TCP over the workspace, with both kinds of uncertainty."""
        return tcp_map(self.fit, self.known, self.values, self.explanations)

    @property
    def invisible(self) -> tuple[str, ...]:
        """Effects that these readings cannot show: not absent, not visible."""
        return self.left.signatures.invisible

    def report(self, folder: str) -> None:
        """Write the report of :func:`close_loop` into a new folder.

        Raises:
            FileError: where the folder exists and is not empty.
        """
        from orthoglide.report import write_verdict

        write_verdict(self, folder)


def close_loop(
    campaigns: Given | Sequence[Given],
    machine: Machine | None = None,
    *,
    own: Sequence[str] = (),
    noise: float | None = None,
    holdout: Given | None = None,
    tcp: TcpPoints | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Verdict:
    """Identify, ask what is left, trace it to a cause, add it, and judge.

    Args:
        campaigns: one or several; paths are read as by ``read_campaign``.
        machine: dimensions, tolerances, dial; nominal where absent.
        own: families or parameters that each campaign has for itself; the rest is shared.
        noise: standard deviation of one reading, metres.
        holdout: a campaign that only judges the finished result.
        tcp: measured points that only judge the finished result.
        seed: of every random draw; the same seed gives the same answer.
        progress: called with each step; any callable will do.

    Raises:
        InputError: where the campaigns cannot be used.
        NumericsError: where the base model cannot be identified.
    """
    machine = machine or Machine.nominal()
    several = as_campaigns(campaigns, machine.spec)
    holdout = None if holdout is None else as_campaigns(holdout, machine.spec)[0]
    progress = progress or silent
    progress(Step("identifying", "joint offsets and leg lengths"))
    level = noise_of(several, machine.spec.dial, noise)
    problem = build_problem(machine, several, BASE_FAMILIES, level, own=own)
    base = solve(problem)
    from orthoglide.diagnosis.blunders import examine, without
    from orthoglide.diagnosis.changes import separated

    progress(Step("faults"))
    findings = examine(base)
    blunders, changes = findings.blunders, findings.changes
    faulty = base if blunders else None
    if blunders:
        problem = without(problem, blunders)
    # What a change put right is no cause now; what is still wrong is named as one.
    causes = [c for c in changes if c.is_cause and c.parameter not in base.names]
    if changes:
        problem = separated(problem, [c for c in changes if c not in causes])
        problem = replace(problem, own=(*problem.own, *(n for c in causes for n in c.own)))
    if blunders or changes:
        base = solve(problem)
    search = Search(problem, progress, np.random.default_rng([seed, 1]))
    search.changed = [c.parameter for c in causes]
    verdict = _search(search, base, tuple(own))
    verdict = replace(
        verdict,
        blunders=blunders,
        changed=tuple(c.measured(verdict.fit) for c in changes),
        faulty=faulty,
        seed=seed,
    )
    progress(Step("judging"))
    return judge(verdict, holdout, tcp)


def judge(verdict: Verdict, holdout: Campaign | None, tcp: TcpPoints | None) -> Verdict:
    """Judge a finished verdict; nothing in it changes but the scores."""
    machine = verdict.fit.problem.machine
    scored = errors = None
    if holdout is not None:
        scored = hold_out(verdict.before, verdict.values, machine, holdout, verdict.own)
    if tcp is not None:
        at_points = tcp_map(
            verdict.fit, verdict.known, verdict.values, verdict.explanations, tcp.command
        )
        errors = tcp_errors(machine, tcp, verdict.before, verdict.values, at_points.sigma_all)
    return replace(verdict, hold_out=scored, tcp=errors, judges=(holdout, tcp))


def _search(search: Search, base: Estimate, own: tuple[str, ...]) -> Verdict:
    fit, left, stopped = search.run(base)
    search.progress(Step("allowing"))
    effects = tuple(search.effects)
    return Verdict(
        _word(effects, left),
        base,
        fit,
        effects,
        tuple(search.tried),
        left,
        stopped,
        knowledge(fit),
        own,
    )


def _word(effects: Sequence[Effect], found: Round) -> Word:
    test = found.detection
    if not effects:
        left = test.p_value < DETECTION or test.lack_of_fit_p < LACK
        return "unexplained" if left else "adequate"
    # To call a machine explained takes more than to leave one alone: what the named cause does not
    # explain counts against noise alone.
    if test.p_value < DETECTION or test.bare_lack_of_fit_p < LACK_AFTER:
        return "partial"
    return "ambiguous" if any(e.rivals for e in effects) else "explained"
