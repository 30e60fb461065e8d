"""``identify``: assembles the problem from readings and machine, solves and checks it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from orthoglide.arguments import public
from orthoglide.errors import InputError, check_choice
from orthoglide.explanation.assumed_noise import check_scatter, with_refuted_noise_enlarged
from orthoglide.explanation.credible_faults import credible_faults
from orthoglide.explanation.faults import fault_message
from orthoglide.explanation.full_posterior import posterior_with_corrected_commands
from orthoglide.explanation.ranked_readings import check_drive_order
from orthoglide.explanation.recalibration import account_for_changes
from orthoglide.fit import Estimate, Problem, assemble, solve
from orthoglide.fit.assembling import read_tables
from orthoglide.fit.crosscheck import verify
from orthoglide.fit.plausible import check_plausible
from orthoglide.fit.solving import Method
from orthoglide.instruments import Frame
from orthoglide.machine import Machine, MachineSource
from orthoglide.notes import Note
from orthoglide.observations import ReadingsOrPath
from orthoglide.parameters import split_campaign
from orthoglide.threads import on_one_thread

_EXACT_SIGMA = 1e-2  # sd of an exact posture, in units of the noise: weights it ten thousandfold

Weighting = Literal["readings", "deviations"]


@public
@on_one_thread
def identify(
    campaigns: ReadingsOrPath | Sequence[ReadingsOrPath],
    machine: MachineSource | None = None,
    free: Sequence[str] | None = None,
    *,
    own: Sequence[str] = (),
    priors: bool = True,
    noise: float | None = None,
    bounds: Mapping[str, float] | None = None,
    weighting: Weighting = "readings",
    method: Method = "auto",
    frame: Frame = "rigid",
) -> Estimate:
    """Identify parameters of the general mechanism from readings.

    Args:
        campaigns: readings of any kinds; paths are read as by ``read_readings``.
        machine: dimensions, tolerances, what is known, or the path of its file; else nominal.
        free: effects, parameters or structured members to identify; joint offsets and leg lengths
            where absent.
        own: which of them each campaign has for itself; the rest is shared.
        priors: whether the machine's tolerances act as priors about zero.
        noise: standard deviation of one reading of a leg, or of the tool where no leg is read,
            metres; see ``noise_of`` where absent.
        bounds: by parameter or family, SI: values stay within plus and minus.
        weighting: ``"readings"`` weighs every reading by its noise, with a free datum a setup;
            ``"deviations"`` is the papers' ordinary least squares on differences from each
            setup's first posture; that posture and the placement of the dials count as exact.
        method: ``"nlp"``, ``"nested"``, ``"pinocchio"`` (nested, closed by Pinocchio: slow) or
            ``"reduction"`` (the analytic PSS model); ``"auto"`` takes the programme for readings of
            legs up to ``NLP_POSTURES`` postures and ``NLP_UNKNOWNS`` unknowns, and else nests the
            closure.
        frame: transformation between a tracker's frame and the machine's that is identified:
            ``"none"``, ``"translation"``, or ``"rigid"``.

    Raises:
        InputError: where what is asked makes no sense.
        UnidentifiableError: where the readings cannot determine it, naming what.
        SolverError: where no solver reaches an answer that passes our own checks.
        CrossCheckError: where mechanism, reduction and Pinocchio disagree beyond 1e-6 mm.
    """
    check_choice("weighting", weighting, get_args(Weighting))
    check_choice("method", method, get_args(Method))
    machine = Machine.of(machine)
    free_names = machine.catalogue.base if free is None else free
    tables = read_tables(campaigns, machine)
    check_plausible(tables, machine, frame)
    problem = assemble(
        tables, machine, free_names,
        per_campaign=own, priors=priors, noise=noise, bounds=bounds, frame=frame,
    )  # fmt: skip
    _check_per_campaign(problem)
    problem = with_refuted_noise_enlarged(problem)
    if weighting == "deviations":
        problem = _with_exact_first_postures(problem)
    estimate = account_for_changes(solve(problem, method=method), method)
    check_drive_order(estimate)
    warnings = (*estimate.warnings, *_tool_fault_notes(estimate))
    return replace(estimate, warnings=warnings, verification=verify(estimate))


def _check_per_campaign(problem: Problem) -> None:
    """Raise an error if a parameter is specific to campaigns but not free."""
    for name in problem.per_campaign:
        plain, _ = split_campaign(name)
        if not any(plain in (n.plain, n.effect) for n in problem.names):
            raise InputError(f"{name} is own to each campaign but not free: free it too")


def _with_exact_first_postures(problem: Problem) -> Problem:
    """Return the problem of the papers: averaged readings with equal weights.

    The first posture of each setup and the placements of the dials are exact.
    """
    factors = []
    for factor in problem.leg_factors:
        readings = factor.readings
        # One row for each setup and posture, as the papers average their repeats.
        table = np.column_stack([readings.setup, readings.command])
        _, first_index, station = np.unique(table, axis=0, return_index=True, return_inverse=True)
        station = station.reshape(-1)
        mean = np.bincount(station, readings.reading) / np.bincount(station)
        first_rows = np.sort(first_index)
        averaged = factor.subset(first_rows).with_readings(mean[station[first_rows]])
        sigma = np.full(len(first_rows), problem.noise.typical)
        _, first_index = np.unique(averaged.setup, return_index=True)
        first_index = first_index[[s.observation.from_datum for s in averaged.readings.setups]]
        sigma[first_index] *= _EXACT_SIGMA
        step = np.full(len(first_rows), problem.noise.resolution)
        noise = replace(averaged.noise, sigma=sigma, common=np.zeros(len(first_rows)), step=step)
        instrument_priors = replace(averaged.instrument_priors, dial_placement_sd=0.0)
        factors.append(replace(averaged, noise=noise, instrument_priors=instrument_priors))
    return problem.with_leg_factors(factors)


def _tool_fault_notes(estimate: Estimate) -> Iterator[Note]:
    """Yield a note on each slip of a tool reading and each moved instrument in a fit that excludes
    no rows.

    Raises:
        InputError: if repeats scatter more than those of a working instrument can.
    """
    problem = estimate.problem
    if not problem.tool_factors:
        return
    check_scatter(problem)
    for fault in credible_faults(posterior_with_corrected_commands(estimate)).certain:
        if problem.setup_of_row[fault.rows[0]] not in problem.leg_setups:
            yield Note(f"{fault_message(problem, fault)}; close-loop sets it aside", "slip")
