"""Before any measurement: the problem that a campaign without readings would pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.effects import CATALOGUE, MACHINE_PARAMETERS, expand, is_dial
from orthoglide.errors import InputError
from orthoglide.fit import Noise, Problem, build_problem, noise_of
from orthoglide.fit.least_squares import Linearised, linearise, normal, nuisances
from orthoglide.fit.noise import PUBLISHED_REPEATABILITY, common_rounding
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign
from orthoglide.planning.bench import Bench, Scatter


def expected_noise(machine: Machine, campaign: Campaign, declared: float | None = None) -> Noise:
    """Noise to reckon with: declared, of the rows, of the machine file, or as published."""
    dial = machine.spec.dial
    if dial.repeatability is None:
        dial = replace(dial, repeatability=PUBLISHED_REPEATABILITY)
    return noise_of([campaign], dial, declared)


def scatter_of(machine: Machine, typical: float) -> Scatter:
    """A reading's scatter, its rounding set apart where repeats share it.

    Args:
        machine: its dial.
        typical: standard deviation of one reading, all counted, metres.
    """
    common = common_rounding(typical, machine.spec.dial.resolution)
    own = np.sqrt(max(typical**2 - common**2, (0.1 * typical) ** 2))
    return Scatter(float(own), common, machine.spec.dial.placement)


@dataclass(frozen=True)
class Expected:
    """A campaign's problem at the machine as it is believed to be.

    Attributes:
        problem: with the readings predicted.
        at: linearised there.
        jacobian: whitened, past datums and placements, in tolerances ``(m, P)``.
    """

    problem: Problem
    at: Linearised
    jacobian: Array

    def with_noise(self, noise: Noise) -> Expected:
        """The same with readings of another noise."""
        problem = replace(self.problem, noise=noise)
        here = normal(problem, self.at, nuisances(problem, self.at.slopes))
        return Expected(problem, self.at, here.jacobian * problem.tolerance)

    @property
    def covariance(self) -> Array:
        """Of the unknowns with tolerances as priors, in tolerances ``(P, P)``."""
        size = self.jacobian.shape[1]
        return np.asarray(np.linalg.inv(self.jacobian.T @ self.jacobian + np.eye(size)))


def expected(
    machine: Machine,
    campaign: Campaign,
    families: Sequence[str],
    noise: Noise | None = None,
) -> Expected:
    """Predict a campaign and linearise it.

    Args:
        machine: as it is believed to be.
        campaign: readings, if there are any, do not count.
        families: families, parameters or structured members to identify.
        noise: of the readings; as :func:`expected_noise` where absent.
    """
    told = campaign.with_readings(machine.readings(campaign))
    level = noise or expected_noise(machine, told)
    problem = build_problem(machine, [told], families, level)
    at = linearise(problem, problem.start)
    here = normal(problem, at, nuisances(problem, at.slopes))
    return Expected(problem, at, here.jacobian * problem.tolerance)


def machine_families(machine: Machine, pool: Campaign, families: Sequence[str]) -> tuple[str, ...]:
    """Parameters of the machine that families stand for, those that nothing can excite left out.

    Raises:
        InputError: for effects of the dial, which belong to a mounting and not to a design.
    """
    dials = [n for n in families if is_dial(n)]
    if dials:
        raise InputError(
            f"{dials[0]} belongs to one mounting of a dial: a design is for parameters of the "
            "machine, leave it out"
        )
    quiet = {"thermal_growth", "thermal_drift"}
    if not pool.load.any():
        quiet.add("drive_compliance")
    if machine.spec.screw_pitch is None:
        quiet.add("screw_error")
    wanted = list(families) or [
        n for n, f in CATALOGUE.items() if f.group != "dial" and n not in quiet
    ]
    still = [n for n in wanted if n.partition(".")[0] in quiet]
    if still:
        raise InputError(
            f"{still[0]} shows in no reading that a design can choose (no load, warmth, drift or "
            "screw pitch is known): leave it out"
        )
    names = [n for n in wanted if n not in CATALOGUE]
    found = dict.fromkeys(expand([n for n in wanted if n in CATALOGUE]))
    return (*found, *names)


def bench_of(
    machine: Machine, pool: Campaign, names: Sequence[str], noise: float | None = None
) -> Bench:
    """A pool linearised by the machine's parameters, each in its tolerance.

    Args:
        machine: as it is believed to be.
        pool: as from ``reading_pool``.
        names: parameters or structured members.
        noise: standard deviation of one reading, metres.
    """
    from orthoglide.effects import elementary

    level = expected_noise(machine, pool, noise)
    readings = machine.model.linearised(machine.values, pool, MACHINE_PARAMETERS)
    place = {n: k for k, n in enumerate(MACHINE_PARAMETERS)}
    weights = np.zeros((len(place), len(names)))
    for k, name in enumerate(names):
        for part, weight in elementary(name).items():
            weights[place[part], k] = weight * machine.tolerance(name)
    return Bench(
        pool, readings.jacobian @ weights, readings.by_gauge, scatter_of(machine, level.typical)
    )
