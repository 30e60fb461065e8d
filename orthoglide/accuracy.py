"""How well the TCP is known over the workspace, before and after, and the two kinds of sigma.

The first kind of sigma counts the noise of the readings as if nothing else were wrong. The second
allows every other effect of the catalogue at its tolerance: what the readings say of those is in
it, and what they cannot see is too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.effects import MACHINE_PARAMETERS, is_dial
from orthoglide.fit import Estimate, Problem, elementary_beyond, with_free
from orthoglide.fit.excited import excited_effects
from orthoglide.fit.least_squares import linearise, normal
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
    known, target = problem.prior_rows
    prior = np.zeros((len(known) + len(x) - own, len(x)))
    prior[: len(known), :own] = known
    prior[len(known) :, own:] = np.diag(1 / wide.tolerance[own:])
    target = np.concatenate([target, np.zeros(len(x) - own)])
    scale = np.concatenate([problem.tolerance, wide.tolerance[own:]])
    # Where the fit lacks something, the readings are worse witnesses of everything else as well.
    noise = estimate.sigma_scale**2
    seen = here.jacobian.T @ here.jacobian / noise
    information = (seen + prior.T @ prior) * scale * scale[:, None]
    gradient = (here.jacobian.T @ here.residual / noise - prior.T @ (prior @ x - target)) * scale
    values, vectors = np.linalg.eigh(information)
    root = vectors / np.sqrt(np.maximum(values, 1e-9 * values.max()))
    covariance = root @ root.T
    names, matrix = wide.elementary(wide.last)
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
    """All other parameters freed, seen or not, that could move the TCP or the readings here."""
    excited = {e.name for e in excited_effects(problem)}
    pitch = problem.machine.spec.screw_pitch is not None
    effects = [
        name
        for name, e in problem.machine.catalogue.items()
        if name in excited
        or ((e.at_rest or (e.of_dial and problem.campaigns)) and (pitch or "pitch" not in e.needs))
    ]
    return with_free(problem, elementary_beyond(problem, effects), release=False)


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
