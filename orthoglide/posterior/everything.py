"""What the readings say of everything at once: the fit's unknowns and all other effects.

The sigmas of a fit count the noise of the readings as if nothing else were wrong. Here every other
effect of the catalogue is allowed too. How large a share of its tolerance, the readings tell: the
share is averaged over with the evidence of each. Where the machine as a whole sits they cannot
tell; that is known to the full tolerances, whatever the share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orthoglide.accuracy import tcp_slopes
from orthoglide.effects import Effect
from orthoglide.fit import Estimate, Problem, elementary_beyond, with_free
from orthoglide.fit.excited import excited_effects
from orthoglide.fit.least_squares import linearise
from orthoglide.geometry import Array
from orthoglide.machine_file import Posterior

SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Shares of their tolerances at which all effects that the fit leaves out are weighed."""

_SHAPELESS = 1e-6  # metres: what changes the shape by less moves the machine as a whole
_WIDE = 1e3  # tolerances: no prior at all


@dataclass(frozen=True, eq=False)
class FullPosterior:
    """Everything that could be wrong, seen through the readings, about the fit.

    Attributes:
        unknowns: the unknowns of the fit, then all others of the catalogue.
        machine: the machine's parameters as the last campaign saw it.
        share: of their tolerances that the readings leave to the effects not in the fit.
    """

    unknowns: Posterior
    machine: Posterior
    share: float


def full_posterior(estimate: Estimate) -> FullPosterior:
    """Allow every other effect of the catalogue, at the shares of its tolerance that fit.

    The effects that were added to the base stand at their tolerance, or, with the evidence of
    that, were not added and are as small as all others.
    """
    problem = estimate.problem
    linear = _Linear.of(estimate)
    kept = [np.isin(np.arange(len(linear.sd)), linear.base)]
    if len(problem.unknowns) > len(linear.base):
        kept.append(np.arange(len(linear.sd)) < len(problem.unknowns))
    cases = [(at_tolerance, share) for at_tolerance in kept for share in SHARES]
    moments, evidence = zip(*(linear.moment(*case) for case in cases), strict=True)
    # Every effect added was chosen among many: with one to a thousandth less is gained than seems.
    added = [int(at_tolerance.sum()) > len(linear.base) for at_tolerance, _ in cases]
    odds = np.array(evidence) - np.log(4 * len(linear.sd)) * np.array(added)
    weight = np.exp(odds - odds.max())
    weight /= weight.sum()
    unknowns = Posterior(linear.names, linear.x, np.einsum("k,kpq->pq", weight, moments))
    share = float(sum(w * share for w, (_, share) in zip(weight, cases, strict=True)))
    names, matrix = linear.machine
    return FullPosterior(unknowns, unknowns.mapped(names, matrix), share)


@dataclass(frozen=True, eq=False)
class _Linear:
    """The readings, linearised about the fit by all unknowns ``P`` that there could be.

    Attributes:
        names: of the unknowns.
        x: the fit, the others at zero ``(P,)``, SI.
        sd: tolerances ``(P,)``, SI.
        base: places of the unknowns that every identification starts with.
        residual: whitened, nuisances projected out ``(m,)``.
        jacobian: the same by the unknowns in tolerances ``(m, P)``.
        translations: orthonormal directions ``(P, 3)`` that move the machine as a whole.
        machine: names of the machine's parameters, and their weights by unknown.
    """

    names: tuple[str, ...]
    x: Array
    sd: Array
    base: list[int]
    residual: Array
    jacobian: Array
    translations: Array
    machine: tuple[tuple[str, ...], Array]

    @classmethod
    def of(cls, estimate: Estimate) -> _Linear:
        problem = estimate.problem
        wide, free = _with_everything(problem), len(problem.unknowns)
        x = np.concatenate([estimate.x, np.zeros(len(wide.unknowns) - free)])
        sd = wide.tolerance.copy()
        sd[:free] = np.minimum(problem.prior_sd, _WIDE * problem.tolerance)
        at, catalogue = linearise(wide, x), problem.machine.catalogue
        # Where the fit lacks something, the readings are worse witnesses of all else as well.
        project, noise = estimate.nuisance.project, estimate.sigma_scale
        machine = _machine_parameters(wide)
        return cls(
            wide.names,
            x,
            sd,
            [
                k
                for k, n in enumerate(problem.names)
                if catalogue.effect_of(n).name in catalogue.base
            ],
            project(wide.measured - at.value) / noise,
            project(at.jacobian) / noise * sd,
            _translations(tcp_slopes(estimate.machine, machine[0]) @ machine[1] * sd),
            machine,
        )

    def moment(self, at_tolerance: NDArray[np.bool_], share: float) -> tuple[Array, float]:
        """Second moment about the fit ``(P, P)``, SI, and log evidence.

        Args:
            at_tolerance: which of the unknowns are allowed their full tolerance ``(P,)``.
            share: that all others are allowed, but for where the machine sits.
        """
        scale = np.where(at_tolerance, 1.0, share)
        missing = np.einsum("pk,p,pk->k", self.translations, 1 - scale**2, self.translations)
        columns = np.hstack([np.diag(scale), self.translations * np.sqrt(missing)])
        start = np.concatenate([self.x / self.sd / scale, np.zeros(len(missing))])
        by_column = self.jacobian @ columns
        gradient = by_column.T @ self.residual - start
        inverse, log_det = _inverse(by_column.T @ by_column + np.eye(len(start)))
        gained = gradient @ inverse @ gradient - start @ start
        shift = columns @ inverse @ gradient
        moment = columns @ inverse @ columns.T + np.outer(shift, shift)
        return moment * self.sd * self.sd[:, None], float(gained - log_det) / 2


def _inverse(matrix: Array) -> tuple[Array, float]:
    values, vectors = np.linalg.eigh(matrix)
    return (vectors / values) @ vectors.T, float(np.log(values).sum())


def _machine_parameters(problem: Problem) -> tuple[tuple[str, ...], Array]:
    """The machine's parameters that the last campaign sets, and their weights by unknown."""
    names, matrix = problem.elementary(problem.last)
    motions = problem.machine.catalogue.motions
    kept = [k for k, name in enumerate(names) if name in motions]
    return tuple(names[k] for k in kept), matrix[kept]


def _translations(slopes: Array) -> Array:
    """Orthonormal directions ``(P, 3)`` of the unknowns that move the machine as a whole.

    Args:
        slopes: TCP by unknown over the workspace, in tolerances ``(g, 3, P)``, metres.
    """
    mean = slopes.mean(axis=0)
    shape = (slopes - mean).reshape(-1, slopes.shape[2]) / np.sqrt(len(slopes)) / _SHAPELESS
    directions = np.linalg.solve(np.eye(shape.shape[1]) + shape.T @ shape, mean.T)
    return np.asarray(np.linalg.qr(directions)[0])


def _with_everything(problem: Problem) -> Problem:
    """All other parameters of the catalogue freed, seen or not, that could move readings or TCP."""
    excited = {effect.name for effect in excited_effects(problem)}

    def counts(effect: Effect) -> bool:
        if "pitch" in effect.needs and problem.machine.spec.screw_pitch is None:
            return False
        at_hand = effect.at_rest or (effect.of_dial and bool(problem.campaigns))
        return at_hand or effect.name in excited

    effects = [effect.name for effect in problem.machine.catalogue.effects if counts(effect)]
    return with_free(problem, elementary_beyond(problem, effects), release=False)
