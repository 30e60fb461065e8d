"""Identification from TCP points that a tracker or a CMM has measured: a mode of its own.

Minimised is ``|(p_measured - T p(x)) / sigma|^2 + |x / prior|^2``, where T is the instrument's
frame: nothing, a translation, or a rigid motion, small and fitted with the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from orthoglide.effects import BASE_FAMILIES, family_of, is_dial
from orthoglide.errors import InputError, SolverError, UnidentifiableError
from orthoglide.fit.least_squares import covariance
from orthoglide.fit.problem import build_unknowns
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign, TcpPoints, protocol
from orthoglide.prediction import Conditions

Frame = Literal["none", "translation", "rigid"]

DEFAULT_SIGMA = 1e-5
"""Metres: of a coordinate where the file declares none."""

_STEPS, _SETTLED = 40, 1e-9


@dataclass(frozen=True)
class TcpEstimate:
    """Parameters identified from TCP points.

    Attributes:
        machine: the calibrated machine.
        names: what was identified.
        x: values ``(P,)``, SI.
        covariance: ``(P, P)``, SI, scaled where lack of fit remains.
        sigma_scale: sqrt(chi2 / dof) where chi2 is improbable, else 1.
        before: root mean square distance of the points from the machine as it was, aligned, metres.
        after: the same of the calibrated machine.
        residuals: measured less predicted, aligned ``(n, 3)``, metres; nan where not measured.
        chi2: data and priors.
        dof: coordinates less the frame, less unknowns without prior.
    """

    machine: Machine
    names: tuple[str, ...]
    x: Array
    covariance: Array
    sigma_scale: float
    before: float
    after: float
    residuals: Array
    chi2: float
    dof: int

    @property
    def values(self) -> dict[str, float]:
        """Identified values by name, SI."""
        return dict(zip(self.names, self.x.tolist(), strict=True))

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviations by name, SI."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


@dataclass(frozen=True)
class _Fit:
    """The points and what is asked of them."""

    machine: Machine
    points: TcpPoints
    conditions: Conditions
    names: tuple[str, ...]
    matrix: Array
    parts: tuple[str, ...]
    held: Mapping[str, float]
    frame: Frame
    known: Array
    weight: Array

    def values(self, x: Array) -> dict[str, float]:
        found = dict(self.held)
        for name, value in zip(self.parts, self.matrix @ x, strict=True):
            found[name] = float(value)
        return found

    def at(self, x: Array, motion: Array) -> tuple[Array, Array]:
        """Whitened residual and Jacobian by unknowns and frame, measured coordinates only."""
        out, by_part = self.machine.model.sensitivities(self.values(x), self.conditions, self.parts)
        p = out.p + motion[:3] + np.cross(motion[3:], out.p)
        by_p = np.cross(motion[3:], np.eye(3), axisb=0, axisc=0) + np.eye(3)
        by_x = np.einsum("ij,njp->nip", by_p, by_part[:, :3] @ self.matrix)
        turn = -np.cross(out.p[:, None, :], np.eye(3)[None], axisa=2, axisb=2).transpose(0, 2, 1)
        shift = np.broadcast_to(np.eye(3), (len(p), 3, 3))
        by_frame = np.concatenate([shift, turn], axis=2)[:, :, : _FRAME[self.frame]]
        rest = (self.points.p - p)[self.known]
        jacobian = np.concatenate([by_x, by_frame], axis=2)[self.known]
        return rest * self.weight, jacobian * self.weight[:, None]


_FRAME = {"none": 0, "translation": 3, "rigid": 6}


def identify_tcp(
    points: TcpPoints,
    machine: Machine | None = None,
    free: Sequence[str] = BASE_FAMILIES,
    *,
    frame: Frame = "rigid",
    priors: bool = True,
    sigma: float | None = None,
) -> TcpEstimate:
    """Identify parameters from measured TCP points.

    Args:
        points: measured, with at least two coordinates more than there is to find.
        machine: dimensions, tolerances and what is held; nominal where absent.
        free: families, parameters or structured members; none of a dial.
        frame: how the instrument's frame may differ from the machine's.
        priors: whether the tolerances act as priors.
        sigma: standard deviation of a coordinate, metres; else the file's, else 0.01 mm.

    Raises:
        InputError: where what is asked makes no sense.
        UnidentifiableError: where the points do not determine it.
        SolverError: where the fit does not settle.
    """
    machine = machine or Machine.nominal()
    fit, tolerance = _fit(machine, points, free, frame, sigma)
    prior = 1 / tolerance if priors else np.zeros(len(tolerance))
    x, motion = np.zeros(len(tolerance)), np.zeros(6)
    start, _ = fit.at(x, motion)
    for _ in range(_STEPS):
        rest, jacobian = fit.at(x, motion)
        full = np.concatenate([prior, np.zeros(jacobian.shape[1] - len(x))])
        augmented = np.vstack([jacobian, np.diag(full)])
        target = np.concatenate([rest, -prior * x, np.zeros(len(full) - len(x))])
        scale = np.linalg.norm(augmented, axis=0)
        scale[scale == 0] = 1.0
        step = np.linalg.lstsq(augmented / scale, target, rcond=1e-13)[0] / scale
        x, motion = (
            x + step[: len(x)],
            motion + np.pad(step[len(x) :], (0, 6 - len(step[len(x) :]))),
        )
        if np.max(np.abs(step) * scale) < _SETTLED * max(float(np.linalg.norm(target)), 1.0):
            break
    else:
        raise SolverError("the fit to the TCP points did not settle; free fewer parameters")
    return _estimate(fit, x, motion, prior, start)


def _fit(
    machine: Machine, points: TcpPoints, free: Sequence[str], frame: Frame, sigma: float | None
) -> tuple[_Fit, Array]:
    if any(is_dial(name) for name in free):
        raise InputError("TCP points say nothing of a dial: free parameters of the machine only")
    carrier: tuple[Campaign, ...] = (protocol("standard", machine.geometry),)
    unknowns = build_unknowns(machine, carrier, free)
    parts = tuple(dict.fromkeys(n for u in unknowns for n in u.parts[0]))
    matrix = np.zeros((len(parts), len(unknowns)))
    for k, unknown in enumerate(unknowns):
        for name, weight in unknown.parts[0].items():
            matrix[parts.index(name), k] = weight
    known = np.isfinite(points.p)
    if known.sum() < len(unknowns) + _FRAME[frame]:
        raise InputError(
            f"{int(known.sum())} measured coordinates are too few for {len(unknowns)} unknowns and "
            f"the instrument's frame: measure more points"
        )
    default = DEFAULT_SIGMA if sigma is None else sigma
    spread = np.where(np.isfinite(points.sigma) & (sigma is None), points.sigma, default)
    weights: Array = (1 / np.repeat(spread[:, None], 3, axis=1))[known]
    conditions = Conditions.at(points.command, approach=points.approach)
    held = {n: v for n, v in machine.values.items() if n not in parts}
    names = tuple(u.name for u in unknowns)
    fit = _Fit(machine, points, conditions, names, matrix, parts, held, frame, known, weights)
    return fit, np.array([u.tolerance for u in unknowns])


def _estimate(fit: _Fit, x: Array, motion: Array, prior: Array, start: Array) -> TcpEstimate:
    from scipy.special import chdtrc

    rest, jacobian = fit.at(x, motion)
    count = len(x)
    chi2 = float(rest @ rest + np.sum((prior * x) ** 2))
    dof = len(rest) - _FRAME[fit.frame] - int(np.sum(prior == 0))
    scale = float(np.sqrt(chi2 / dof)) if dof > 0 and chdtrc(dof, chi2) < 0.01 else 1.0
    full = np.concatenate([prior, np.zeros(jacobian.shape[1] - count)])
    spread, unseen = covariance(jacobian / scale, full)
    lost = [
        n for n, share in zip(fit.names, np.abs(unseen[:, :count]).T, strict=True) if share.any()
    ]
    if lost:
        raise UnidentifiableError(
            f"these points do not determine {', '.join(lost)} with the instrument's frame free: "
            f"free fewer parameters or let the tolerances act as priors"
        )
    residuals = np.full(fit.points.p.shape, np.nan)
    residuals[fit.known] = rest / fit.weight
    values = dict(zip(fit.names, x.tolist(), strict=True))
    sigmas = dict(zip(fit.names, np.sqrt(np.diag(spread)[:count]).tolist(), strict=True))
    machine = Machine(replace(fit.machine.spec)).with_parameters(values, sigmas)
    return TcpEstimate(
        machine, fit.names, x, spread[:count, :count], scale,
        _aligned_rms(fit, start), float(np.sqrt(np.nanmean(np.sum(residuals**2, axis=1)))),
        residuals, chi2, dof,
    )  # fmt: skip


def _aligned_rms(fit: _Fit, start: Array) -> float:
    """Distance of the points from the machine as it was, after the best motion of the frame."""
    _, jacobian = fit.at(np.zeros(len(fit.names)), np.zeros(6))
    frame = jacobian[:, len(fit.names) :]
    left = start - frame @ np.linalg.lstsq(frame, start, rcond=None)[0] if frame.size else start
    apart = np.full(fit.points.p.shape, np.nan)
    apart[fit.known] = left / fit.weight
    return float(np.sqrt(np.nanmean(np.nansum(apart**2, axis=1))))


def table(estimate: TcpEstimate) -> list[tuple[str, str, str, str]]:
    """Rows for people: name, value, sigma, unit."""
    rows = []
    for name, value in estimate.values.items():
        unit = family_of(name).unit
        sigma = estimate.sigmas[name] / unit.si
        rows.append((name, f"{value / unit.si:+.4g}", f"{sigma:.2g}", unit.name))
    return rows
