"""How well the TCP is known over the workspace, before and after, and the two kinds of sigma.

The first kind of sigma counts the noise of the readings as if nothing else were wrong. The second
allows every other effect of the catalogue at its tolerance: what the readings say of those is in
it, and what they cannot see is too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.effects import CATALOGUE, MACHINE_PARAMETERS, family_of, is_dial
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.least_squares import linearise, normal
from orthoglide.fit.problem import build_unknowns
from orthoglide.geometry import Array, Geometry
from orthoglide.prediction import Conditions

GRID = 5
"""Commands along each axis of the map of the workspace."""


def workspace(geometry: Geometry, count: int = GRID) -> Array:
    """Commands ``(count^3, 3)`` that fill the stroke evenly, metres."""
    travel = geometry.L + np.linspace(*geometry.stroke, count)
    return np.stack(np.meshgrid(travel, travel, travel, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class Knowledge:
    """Everything that could be wrong, seen through the readings: a Gaussian around the fit.

    Attributes:
        names: unknowns of the fit, then all others of the catalogue.
        own: how many of them are the fit's.
        shift: from the fit to the mean with all others allowed ``(E,)``, SI.
        covariance: with all others allowed ``(E, E)``, SI.
        weights: elementary machine parameters of the last campaign for each unknown ``(63, E)``.
    """

    names: tuple[str, ...]
    own: int
    shift: Array
    covariance: Array
    weights: Array

    @property
    def sigmas(self) -> dict[str, float]:
        """Sigmas of the second kind of the fit's unknowns: spread, and distance from the fit."""
        spread = np.diag(self.covariance)[: self.own] + self.shift[: self.own] ** 2
        return dict(zip(self.names[: self.own], np.sqrt(spread).tolist(), strict=True))


def knowledge(estimate: Estimate) -> Knowledge:
    """Allow every other effect of the catalogue at its tolerance, and look at the readings."""
    problem = estimate.problem
    wide = _with_everything(problem)
    own = len(problem.unknowns)
    x = np.concatenate([estimate.x, np.zeros(len(wide.unknowns) - own)])
    at = linearise(wide, x)
    here = normal(replace(wide, priors=True), at, estimate.nuisance)
    prior = here.prior.copy()
    prior[:own] = 1 / problem.prior_sd
    scale = np.concatenate([problem.tolerance, wide.tolerance[own:]])
    # Where the fit lacks something, the readings are worse witnesses of everything else as well.
    noise = estimate.sigma_scale**2
    seen = here.jacobian.T @ here.jacobian / noise
    information = (seen + np.diag(prior**2)) * scale * scale[:, None]
    gradient = (here.jacobian.T @ here.residual / noise - prior**2 * x) * scale
    values, vectors = np.linalg.eigh(information)
    root = vectors / np.sqrt(np.maximum(values, 1e-9 * values.max()))
    covariance = root @ root.T
    names, matrix = wide.elementary(len(wide.campaigns) - 1)
    weights = np.zeros((len(MACHINE_PARAMETERS), len(wide.unknowns)))
    for name, row in zip(names, matrix, strict=True):
        if not is_dial(name):
            weights[MACHINE_PARAMETERS.index(name)] = row
    return Knowledge(
        wide.names,
        own,
        scale * (covariance @ gradient),
        covariance * scale * scale[:, None],
        weights,
    )


def _with_everything(problem: Problem) -> Problem:
    """All other parameters of the catalogue freed, seen or not; screws of unknown pitch apart."""
    taken = {p for u in problem.unknowns for parts in u.parts for p in parts}
    families = [
        f for f in CATALOGUE if f != "screw_error" or problem.machine.spec.screw_pitch is not None
    ]
    everything = build_unknowns(problem.machine, problem.campaigns, families, problem.own)
    others = tuple(u for u in everything if not any(p in taken for parts in u.parts for p in parts))
    # Without a load, drifting time or warmth in the question, their effects do not move the TCP.
    quiet = {"drive_compliance", "thermal_growth", "thermal_drift"}
    kept = tuple(
        u for u in others if family_of(u.name).name not in quiet or _varies(problem, u.name)
    )
    return replace(problem, unknowns=(*problem.unknowns, *kept))


def _varies(problem: Problem, name: str) -> bool:
    from orthoglide.diagnosis.candidates import excited_families

    return family_of(name).name in excited_families(problem)


@dataclass(frozen=True)
class Map:
    """The predicted TCP over a set of commands.

    Attributes:
        commands: ``(g, 3)``, metres.
        nominal: TCP of the machine without errors ``(g, 3)``.
        p: TCP of the calibrated machine ``(g, 3)``.
        sigma: of the first kind ``(g, 3)``, best translation removed.
        sigma_all: of the second kind ``(g, 3)``, best translation removed.
    """

    commands: Array
    nominal: Array
    p: Array
    sigma: Array
    sigma_all: Array

    @property
    def error(self) -> Array:
        """Distance of the calibrated TCP from the nominal ``(g,)``, best translation removed."""
        apart = self.p - self.nominal
        return np.asarray(np.linalg.norm(apart - apart.mean(axis=0), axis=1))

    @property
    def uncertainty(self) -> Array:
        """95 % radius by the second kind of sigma, each coordinate's taken together ``(g,)``."""
        return np.asarray(1.96 * np.linalg.norm(self.sigma_all, axis=1))


def tcp_map(
    estimate: Estimate,
    known: Knowledge,
    values: Mapping[str, float],
    explanations: tuple[tuple[float, Mapping[str, float]], ...] = (),
    commands: Array | None = None,
) -> Map:
    """Predict the TCP and its uncertainty over the workspace.

    Args:
        estimate: the fit.
        known: as from :func:`knowledge`.
        values: parameters of the calibrated machine, SI.
        explanations: weights and parameters of all that fit as well, whose distance from
            ``values`` counts as uncertainty.
        commands: ``(g, 3)``; the grid of :func:`workspace` where absent.
    """
    model = estimate.problem.machine.model
    where = workspace(model.geometry) if commands is None else commands
    conditions = Conditions.at(where)
    machine = {n: v for n, v in values.items() if not is_dial(n)}
    outputs, by_theta = model.sensitivities(machine, conditions, MACHINE_PARAMETERS)
    slope = by_theta[:, :3] @ known.weights  # (g, 3, E)
    slope = slope - slope.mean(axis=0)
    shift = slope @ known.shift
    variance_all = np.einsum("gie,ef,gif->gi", slope, known.covariance, slope) + shift**2
    own = slope[:, :, : known.own]
    variance = np.einsum("gie,ef,gif->gi", own, estimate.covariance, own)
    for weight, other in explanations:
        rival = model.outputs({n: v for n, v in other.items() if not is_dial(n)}, conditions).p
        apart = rival - outputs.p
        variance_all = variance_all + weight * (apart - apart.mean(axis=0)) ** 2
    nominal = model.outputs({}, conditions).p
    return Map(where, nominal, outputs.p.copy(), np.sqrt(variance), np.sqrt(variance_all))
