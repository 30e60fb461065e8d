"""``identify``: what a user asks, put together as a problem, solved and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from orthoglide.errors import InputError, check_choice
from orthoglide.explanation.data_faults import tool_fault_notes
from orthoglide.explanation.recalibration import account_for_changes
from orthoglide.explanation.repeats import with_refuted_noise_enlarged
from orthoglide.fit import Estimate, Problem, assemble, solve
from orthoglide.fit.assembling import read_tables
from orthoglide.fit.crosscheck import verify
from orthoglide.fit.plausible import check_drive_order, check_plausible
from orthoglide.fit.solving import Method
from orthoglide.instruments import Frame
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import ReadingsOrPath
from orthoglide.parameters import split_campaign
from orthoglide.threads import on_one_thread

_EXACT_SIGMA = 1e-2  # of the noise; leaves a ten-thousandth of what a free datum takes up

Weighting = Literal["readings", "deviations"]


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
    chosen = machine.catalogue.base if free is None else free
    read = read_tables(campaigns, machine)
    check_plausible(read, machine, frame)
    problem = assemble(
        read, machine, chosen,
        per_campaign=own, priors=priors, noise=noise, bounds=bounds, frame=frame,
    )  # fmt: skip
    _check_per_campaign(problem)
    problem = with_refuted_noise_enlarged(problem)
    if weighting == "deviations":
        problem = _with_exact_first_postures(problem)
    found = account_for_changes(solve(problem, method=method), method)
    check_drive_order(found)
    warnings = (*found.warnings, *tool_fault_notes(found))
    return replace(found, warnings=warnings, verification=verify(found))


def _check_per_campaign(problem: Problem) -> None:
    """Refuse what is own to each campaign and not free."""
    for name in problem.per_campaign:
        plain, _ = split_campaign(name)
        if not any(plain in (n.plain, n.effect) for n in problem.names):
            raise InputError(f"{name} is own to each campaign but not free: free it too")


def _with_exact_first_postures(problem: Problem) -> Problem:
    """Averaged readings, equal weights, each setup's first posture and the dials' places exact."""
    factors = []
    for factor in problem.leg_factors:
        every = factor.readings
        # One row a setup and posture, as the papers average their repeats.
        table = np.column_stack([every.setup, every.command])
        _, first, station = np.unique(table, axis=0, return_index=True, return_inverse=True)
        station = station.reshape(-1)
        mean = np.bincount(station, every.reading) / np.bincount(station)
        kept = np.sort(first)
        some = factor.subset(kept).with_readings(mean[station[kept]])
        sigma = np.full(len(kept), problem.noise.typical)
        _, first = np.unique(some.setup, return_index=True)
        first = first[[s.observation.from_datum for s in some.readings.setups]]
        sigma[first] *= _EXACT_SIGMA
        step = np.full(len(kept), problem.noise.resolution)
        noise = replace(some.noise, sigma=sigma, common=np.zeros(len(kept)), step=step)
        beliefs = replace(some.instrument_priors, dial_placement_sd=0.0)
        factors.append(replace(some, noise=noise, instrument_priors=beliefs))
    return problem.with_leg_factors(factors)
