"""The smallest effects that a protocol would find, and the smallest that it could name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from scipy.special import ndtri

from orthoglide.arguments import public
from orthoglide.effects import CATALOGUE
from orthoglide.effects.wording import parameter_words
from orthoglide.errors import InputError, check_integer, check_list
from orthoglide.explanation.candidates import Candidate, Signatures, signatures
from orthoglide.explanation.change_search import INDISTINGUISHABLE_CHI2
from orthoglide.fit import Problem, assemble, expected_sigma, solve
from orthoglide.frames import Framed
from orthoglide.geometry import Array
from orthoglide.layout import LegNames
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings
from orthoglide.ordering import best_of, largest
from orthoglide.parameters import Parameter
from orthoglide.planning.linear import with_repeatability
from orthoglide.simulation import simulate
from orthoglide.text import abbreviated
from orthoglide.units import Unit

POWER = 0.95
"""Probability with which an effect of the size stated is found, or named."""

_DRAWS = 1999  # draws of the noise from which the threshold is taken
_MIN_SINE = 1e-3  # sine between signatures below which no size of an effect separates them
_COLUMNS = (
    "effect", "unit", "tolerance", "found from", "named from", "hardest", "nearest", "parameters",
)  # fmt: skip


@dataclass(frozen=True)
class SmallestEffect:
    """Smallest sizes of one candidate that a protocol detects and names."""

    name: Parameter  # of the candidate
    tolerance: float  # of its parameter, SI
    unit: Unit  # of its parameter in files
    detectable: float  # size that is found with 95 % probability, SI
    nameable: float  # size at which no other effect fits as well, with 95 % probability; or inf
    nearest: Parameter | str  # most similar candidate of another effect; empty: there is none
    elementary: bool  # whether it is a single parameter, no structured member

    @property
    def effect(self) -> str:
        """Name of its effect."""
        return self.name.effect


@dataclass(frozen=True)
class Detectability(Framed):
    """Detectable sizes of the catalogue; as a table, a row for each effect."""

    smallest: tuple[SmallestEffect, ...]  # by candidate, in the order of the catalogue
    invisible: tuple[Parameter, ...]  # parameters that these readings cannot show at any size
    threshold: float  # evidence that noise alone exceeds with the probability asked for
    legs: LegNames = CATALOGUE.legs  # names of the machine's legs and parts
    _index = "effect"

    def __repr__(self) -> str:
        return f"<the smallest of {len(self.by_effect)} effects found and named>"

    @property
    def by_effect(self) -> dict[str, list[SmallestEffect]]:
        """Single parameters by their effect."""
        groups: dict[str, list[SmallestEffect]] = {}
        for smallest in filter(lambda s: s.elementary, self.smallest):
            groups.setdefault(smallest.effect, []).append(smallest)
        return groups

    @property
    def columns(self) -> dict[str, list[Any]]:
        """A row for each effect, in the units of files: the sizes from which all of its parameters
        are found and named, and the parameter that is named last. Parameters are listed where
        others of the effect are invisible.
        """
        rows = []
        for effect, members in self.by_effect.items():
            hardest = best_of(members, lambda s: s.nameable)
            unit, size = hardest.unit, max(s.detectable for s in members)
            is_partly_hidden = any(name.effect == effect for name in self.invisible)
            listed = ", ".join(s.name.behind for s in members) * is_partly_hidden
            figures = (v / unit.si for v in (hardest.tolerance, size, hardest.nameable))
            rows.append((effect, unit.name, *figures, hardest.name, hardest.nearest, listed))
        return {title: [row[k] for row in rows] for k, title in enumerate(_COLUMNS)}


def detectable_rows(sheet: Detectability) -> list[str]:
    """Return rows of text, one for each effect: the sizes from which all of its parameters are
    found and named, and what the hardest of them is most like.
    """
    legs = sheet.legs
    lines = [f"{'effect':<22}{'tolerance':>10}{'found from':>11}{'named from':>11}  unit"]
    for row in zip(*sheet.columns.values(), strict=True):
        effect, unit, tolerance, size, named, hardest, nearest, parameters = row
        words = abbreviated(legs.effect_words(effect), 21)
        named_text = f"{named:.2g}" if np.isfinite(named) else "never"
        lines.append(f"{words:<22}{tolerance:>10.2g}{size:>11.2g}{named_text:>11}  {unit}")
        if parameters:
            lines.append(f"    of {parameters}")
        if nearest:
            alternative = parameter_words(nearest, legs)
            lines.append(f"    {parameter_words(hardest, legs)} is most like {alternative}")
    groups: dict[str, list[str]] = {}
    for name in sheet.invisible:
        groups.setdefault(legs.effect_words(name.effect), []).append(name.behind)
    if groups:
        effects = (f"{effect} ({', '.join(members)})" for effect, members in groups.items())
        lines.append(f"not detectable: {', '.join(effects)}")
    return lines


@public
def smallest_effects(
    machine: MachineSource,
    campaign: Readings | Sequence[Readings],
    *,
    names: Sequence[str] = (),
    level: float = 0.01,
    noise: float | None = None,
    seed: int = 0,
) -> Detectability:
    """Return the sizes of effect that a protocol detects and names with 95 % probability.

    An effect of v tolerances has the evidence ``(w X - log(1 + |S|^2)) / 2``. S is its signature,
    whitened by the noise and by the small errors of a sound machine, which precise instruments
    show; X is noncentral chi-squared with one degree of freedom and noncentrality ``v^2 |S|^2``,
    ``w = |S|^2 / (1 + |S|^2)``. It is detected above the evidence that the best of the catalogue
    reaches on noise with probability ``level``. It is named where the best fit of every other
    effect is worse by a chi2 of 4.

    Args:
        machine: as it is believed to be, or the path of its file.
        campaign: stations and setups, of several instruments too; readings do not count.
        names: effects or parameters to report, all if empty; all compete in any case.
        level: family-wise probability of a false alarm.
        noise: standard deviation of one reading, metres.
        seed: of the bootstrap on noise.

    Raises:
        InputError: for unknown names, a level that is no probability, and a negative seed.
    """
    machine = Machine.of(machine)
    check_list("names", () if names is None else names)
    machine.catalogue.expand(names)
    model = signatures(solve(predicted_problem(machine, campaign, noise), method="nested"))
    weighted = model.weighted_by_background
    threshold = _evidence_threshold(weighted, level, seed)
    single = [c for c in model.candidates if c.size == 1]
    length, cosine = _signature_cosines(weighted, single)
    catalogue, smallest = machine.catalogue, []
    for k, candidate in enumerate(single):
        if names and not {candidate.effect, candidate.name} & set(names):
            continue
        tolerance = float(np.abs(model.weights_at_tolerance(candidate)).max())
        closest = largest(cosine[k])
        detectable = float(np.sqrt(noncentrality(length[k] ** 2, threshold)) / length[k])
        sine = float(np.sqrt(max(1 - cosine[k, closest] ** 2, 0.0)))
        apart = np.inf if sine < _MIN_SINE else required_separation() / (length[k] * sine)
        smallest.append(
            SmallestEffect(
                catalogue.parameter(candidate.name),
                tolerance,
                catalogue[candidate.effect].unit,
                detectable * tolerance,
                max(detectable, float(apart)) * tolerance,
                catalogue.parameter(single[closest].name) if cosine[k, closest] > 0 else "",
                candidate.name in model.names,
            )
        )
    invisible = tuple(n for n in model.invisible if not names or {n, n.effect} & set(names))
    return Detectability(tuple(smallest), invisible, threshold, catalogue.legs)


def predicted_problem(
    machine: Machine, sheet: Readings | Sequence[Readings], noise: float | None = None
) -> Problem:
    """Return the problem of joint offsets and leg lengths on the readings predicted for sheets.

    Args:
        machine: as it is believed to be.
        sheet: one table or several; their readings do not count.
        noise: standard deviation of one reading, metres.
    """
    rated = replace(machine, spec=with_repeatability(machine.spec))
    # Predictions are exact, so the noise is declared: it cannot be estimated from their repeats.
    sheets = [sheet] if isinstance(sheet, Readings) else sheet
    if not len(sheets):
        raise InputError("there are no readings: give at least one table of them")
    predicted = []
    for exact in (simulate(machine, readings, exact=True) for readings in sheets):
        sigma = expected_sigma(exact, machine.spec) if exact.of_tool else exact.sigma
        predicted.append(replace(exact, sigma=sigma))
    return assemble(predicted, rated, machine.catalogue.base, noise=noise)


def _evidence_threshold(weighted: Signatures, level: float, seed: int) -> float:
    """Return the evidence that the best candidate exceeds with probability ``level`` on noise."""
    if not (isinstance(level, Real) and 0 < level < 1):
        raise InputError(f"level is a probability between 0 and 1, such as 0.01, not {level!r}")
    rng = np.random.default_rng(check_integer("seed", seed, 0))
    if not weighted.candidates:
        return 0.0
    noise = rng.standard_normal((len(weighted.columns), _DRAWS))
    best_evidence = weighted.evidences(noise).max(axis=0)
    return float(np.quantile(best_evidence, 1 - level))


def _signature_cosines(model: Signatures, single: Sequence[Candidate]) -> tuple[Array, Array]:
    """Return the lengths of signatures ``(k,)``, and cosines ``(k, k)`` of different effects."""
    none = np.zeros((len(model.columns), 0))
    columns = np.column_stack([none, *(model.signature(c) for c in single)])
    length = np.linalg.norm(columns, axis=0)
    cosine = np.abs(columns.T @ columns) / np.multiply.outer(length, length)
    effects = np.array([c.effect for c in single])
    cosine[np.equal.outer(effects, effects)] = 0.0  # members of one effect are no rivals here
    return length, cosine


def noncentrality(square: float, threshold: float) -> float:
    """Return the noncentrality at which an effect's evidence exceeds a threshold with the
    probability `POWER`; ``square`` is that of its signature at tolerance.
    """
    # X is the square of a normal number; its other tail is below 1e-9 at every threshold above 1.
    limit = (2 * threshold + np.log1p(square)) * (1 + square) / square
    return float((np.sqrt(max(limit, 0.0)) + ndtri(POWER)) ** 2)


def required_separation() -> float:
    """Return the distance in sigmas from which the wrong fit's chi2 is larger by more than that of
    indistinguishable explanations.

    The difference of chi2 at distance D is normal with mean D^2 and standard deviation 2 D.
    """
    z = float(ndtri(POWER))
    return z + float(np.sqrt(z**2 + INDISTINGUISHABLE_CHI2))
