"""Rows of the tables that terminal and page share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from orthoglide.effects import family_of
from orthoglide.geometry import LEGS
from orthoglide.numerals import compact, decimals_for, plain, probability, signed

if TYPE_CHECKING:
    from orthoglide.fit import Estimate
    from orthoglide.machine import Machine


@dataclass(frozen=True)
class ParameterRow:
    """One identified value, ready to print."""

    name: str
    value: str
    sigma: str
    low: str
    high: str
    tolerance: str
    unit: str
    on_bound: bool


def parameter_rows(estimate: Estimate) -> list[ParameterRow]:
    """One row an unknown, in its file's unit."""
    rows = []
    for name, tolerance in zip(estimate.names, estimate.problem.tolerance, strict=True):
        unit = family_of(name).unit
        sigma = estimate.sigmas[name] / unit.si
        places = decimals_for(sigma, most=9)
        low, high = (signed(end / unit.si, places) for end in estimate.interval(name))
        rows.append(
            ParameterRow(
                name,
                signed(estimate.values[name] / unit.si, places),
                f"{sigma:.{places}f}",
                low,
                high,
                compact(tolerance / unit.si),
                unit.name,
                name in estimate.on_bound,
            )
        )
    return rows


@dataclass(frozen=True)
class ScoreRow:
    """One figure of merit before and after."""

    what: str
    before: str
    after: str
    meaning: str


def score_rows(estimate: Estimate) -> list[ScoreRow]:
    """Figures of the machine as it was and of the fit."""
    before, after = estimate.nominal, estimate.scores

    def mm(what: str, name: str, meaning: str) -> ScoreRow:
        first, second = (f"{getattr(score, name) * 1e3:.3f}" for score in (before, after))
        return ScoreRow(what, first, second, meaning)

    return [
        mm("deviations, rms, mm", "deviation_rms",
           "of the averaged readings against each setup's first posture: the papers' figure"),
        mm("residuals, rms, mm", "rms", "of all readings, each dial's zero fitted"),
        mm("largest residual, mm", "max", ""),
        mm("stations left out, rms, mm", "cv_rms",
           "readings predicted without any reading of the same setup and posture"),
        ScoreRow("chi²", f"{before.chi2:.1f}", f"{after.chi2:.1f}",
                 "squared residuals in units of the noise, tolerances included"),
        ScoreRow("degrees of freedom", str(before.dof), str(after.dof),
                 "what chi² should be about if nothing but noise were left"),
        ScoreRow("probability", probability(before.lack_of_fit_p),
                 probability(after.lack_of_fit_p), "of a chi² as large by noise alone"),
    ]  # fmt: skip


@dataclass(frozen=True)
class ControllerRow:
    """What to tell the controller of one axis; lengths in millimetres."""

    axis: str
    offset: str
    sigma: str
    add: str
    zero_was: str
    zero_is: str
    example_shown: str
    example_true: str
    example_command: str


class Calibrated(Protocol):
    """Anything with a calibrated machine: an estimate, a verdict."""

    @property
    def machine(self) -> Machine:
        """The machine as it was found."""


def controller_rows(estimate: Calibrated) -> list[ControllerRow]:
    """Numbers for the controller, from rho = L + sign (travel - zero) and rho true = rho + offset.

    So the carriage stands right if ``sign x offset`` is added to what the controller shows, or is
    subtracted from what it is told; and ``zero - sign x offset`` is what it shows at mechanical
    zero. Empty where no joint offset is known.
    """
    spec = estimate.machine.spec
    offsets = [spec.parameters.get(f"joint_offset.{leg}") for leg in LEGS]
    if not any(offsets):
        return []
    rows = []
    for axis, leg, entry in zip(range(3), LEGS, offsets, strict=True):
        value = (entry.value if entry else 0.0) * 1e3
        sigma = (entry.sigma if entry else 0.0) * 1e3
        sign, zero = spec.controller.sign[axis], spec.controller.zero[axis] * 1e3
        rows.append(
            ControllerRow(
                leg,
                signed(value, 3),
                f"{sigma:.{decimals_for(sigma, 3)}f}",
                signed(sign * value, 3),
                plain(zero, 3),
                plain(zero - sign * value, 3),
                plain(zero, 3),
                plain(spec.geometry.L * 1e3 + value, 3),
                plain(zero - sign * value, 3),
            )
        )
    return rows
