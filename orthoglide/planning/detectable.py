"""The smallest effects that a protocol would find, and the smallest that it could name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from orthoglide.effects import CATALOGUE
from orthoglide.effects.wording import parameter_words
from orthoglide.errors import InputError, check_integer, check_list
from orthoglide.explanation.candidates import Candidate
from orthoglide.explanation.change_model import INDISTINGUISHABLE_CHI2
from orthoglide.explanation.signatures import Scoring, Signatures, signatures
from orthoglide.explanation.significance import DRAWS, noise_residuals
from orthoglide.fit import solve
from orthoglide.frames import Framed
from orthoglide.geometry import Array
from orthoglide.layout import LegNames
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of, largest, ranked
from orthoglide.parameters import Parameter
from orthoglide.planning.linear import predicted_problem
from orthoglide.text import abbreviated
from orthoglide.units import Unit

POWER = 0.95
"""Probability with which an effect of the size stated is found, or named."""

_MIN_SINE = 1e-3  # sine between signatures that no size of effect would tell apart
_ROW_FACTOR = 2.0  # parameters of one effect found from sizes within this factor share a row


@dataclass(frozen=True)
class SmallestEffect:
    """Smallest sizes of one candidate that a protocol detects and names."""

    name: Parameter  # of the candidate
    effect: str  # name of its effect
    tolerance: float  # of its parameter, SI
    unit: Unit  # of its parameter in files
    detectable: float  # size that is found with 95 % probability, SI
    # size at which no other effect fits as well, with 95 % probability, SI; infinite where one
    # always does
    nameable: float
    # candidate of another effect that is hardest to tell from it; empty: there is none
    nearest: Parameter | str
    elementary: bool  # whether it is a single parameter, no structured member


@dataclass(frozen=True)
class Detectability(Framed):
    """What a protocol makes of the whole catalogue; as a table, a row for the parameters of an
    effect that are found from about the same size.
    """

    # by candidate of one parameter, in the order of the catalogue
    smallest: tuple[SmallestEffect, ...]
    # parameters that these readings cannot show, whatever their size within reason
    invisible: tuple[Parameter, ...]
    threshold: float  # evidence that noise alone exceeds with the probability asked for
    legs: LegNames = CATALOGUE.legs  # names of the machine's legs and parts
    _index = "effect"

    def __repr__(self) -> str:
        return f"<the smallest of {len(self.by_effect)} effects found and named>"

    @property
    def by_effect(self) -> dict[str, list[SmallestEffect]]:
        """Single parameters by their effect."""
        found: dict[str, list[SmallestEffect]] = {}
        for one in self.smallest:
            if one.elementary:
                found.setdefault(one.effect, []).append(one)
        return found

    @property
    def alike(self) -> list[list[SmallestEffect]]:
        """Single parameters of one effect together that are found from about the same size, the
        easiest first: a further instrument shows parameters that are hard to see, which say nothing
        of the others.
        """
        groups: list[list[SmallestEffect]] = []
        for members in self.by_effect.values():
            least = 0.0
            for one in ranked(members, lambda s: -float(np.log(s.detectable)), LOG_ODDS_MARGIN):
                if not least or one.detectable > _ROW_FACTOR * least:
                    least = one.detectable
                    groups.append([])
                groups[-1].append(one)
        return groups

    @property
    def columns(self) -> dict[str, list[Any]]:
        """A row for each group of :attr:`alike`, in the units of files."""
        every = self.alike
        hardest = [best_of(members, lambda s: s.nameable) for members in every]
        found = [max(s.detectable for s in members) for members in every]
        return {
            "effect": [s.effect for s in hardest],
            "unit": [s.unit.name for s in hardest],
            "tolerance": [s.tolerance / s.unit.si for s in hardest],
            "found from": [v / s.unit.si for s, v in zip(hardest, found, strict=True)],
            "named from": [s.nameable / s.unit.si for s in hardest],
            "hardest": [s.name for s in hardest],
            "nearest": [s.nearest for s in hardest],
            "parameters": [self._parameters(members) for members in every],
        }

    def _parameters(self, members: Sequence[SmallestEffect]) -> str:
        """Return those of one row, without their effect's name; nothing where they are all."""
        effect = members[0].effect
        hidden = sum(name.effect == effect for name in self.invisible)
        if len(members) == len(self.by_effect[effect]) + hidden:
            return ""
        return ", ".join(s.name.behind for s in self.by_effect[effect] if s in members)


def detectable_rows(found: Detectability, beyond: float = 0.0) -> list[str]:
    """Return rows of text, one for the parameters of an effect that are found from about the same
    size: the largest sizes that one of them takes to be found, and to be named; below it what the
    hardest of them looks like.

    Args:
        found: of a sheet.
        beyond: tolerances; effects that are found and named from less have no row.
    """
    lines = [f"{'effect':<22}{'tolerance':>10}{'found from':>11}{'named from':>11}  unit"]
    for row in zip(*found.columns.values(), strict=True):
        effect, unit, tolerance, size, named, hardest, nearest, parameters = row
        if max(size, named) <= beyond * tolerance:
            continue
        words = abbreviated(found.legs.effect_words(effect), 21)
        shown = f"{named:.2g}" if np.isfinite(named) else "never"
        lines.append(f"{words:<22}{tolerance:>10.2g}{size:>11.2g}{shown:>11}  {unit}")
        if parameters:
            lines.append(f"    of {parameters}")
        if nearest:
            one, other = (parameter_words(n, found.legs) for n in (hardest, nearest))
            lines.append(f"    {one} looks like {other}")
    groups: dict[str, list[str]] = {}
    for name in found.invisible:
        groups.setdefault(found.legs.effect_words(name.effect), []).append(name.behind)
    if groups:
        every = (f"{effect} ({', '.join(members)})" for effect, members in groups.items())
        lines.append(f"not detectable: {', '.join(every)}")
    return lines


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

    An effect of v tolerances with signature S has the evidence ``(w X - log(1 + |S|^2)) / 2``, X
    noncentral chi-squared with one degree of freedom and noncentrality ``v^2 |S|^2``,
    ``w = |S|^2 / (1 + |S|^2)``. It is detected above the evidence that the best of the catalogue
    reaches on noise with probability ``level``. It is named where the best fit of every other
    effect is worse by a chi2 of 4.

    Args:
        machine: as it is believed to be, or the path of its file.
        campaign: stations and setups, of several instruments too; readings do not count.
        names: effects or parameters to report; all where empty. The catalogue competes whole in
            any case.
        level: family-wise probability of a false alarm.
        noise: standard deviation of one reading, metres.
        seed: of the bootstrap on noise.

    Raises:
        InputError: for names that are neither effects nor parameters, a level that is no
            probability, and a negative seed.
    """
    machine = Machine.of(machine)
    check_list("names", names)
    machine.catalogue.expand(names)
    seen = signatures(solve(predicted_problem(machine, campaign, noise), method="nested"))
    scoring = Scoring.prepare(seen, seen.candidates)
    threshold = _evidence_threshold(seen, scoring, level, seed)
    single = [c for c in scoring.candidates if c.size == 1]
    length, cosine = _signature_cosines(seen, single)
    found = []
    for k, candidate in enumerate(single):
        if names and not {candidate.effect, candidate.name} & set(names):
            continue
        tolerance = float(np.abs(seen.weights_at_tolerance(candidate)).max())
        closest = largest(cosine[k])
        detectable, nameable = _smallest_sizes(length[k], float(cosine[k, closest]), threshold)
        found.append(
            SmallestEffect(
                machine.catalogue.parameter(candidate.name),
                candidate.effect,
                tolerance,
                machine.catalogue[candidate.effect].unit,
                detectable * tolerance,
                nameable * tolerance,
                machine.catalogue.parameter(single[closest].name) if cosine[k, closest] > 0 else "",
                candidate.name in seen.names,
            )
        )
    effect_of = machine.catalogue.effect_of
    hidden = [n for n in seen.invisible if not names or {n, effect_of(n).name} & set(names)]
    return Detectability(tuple(found), tuple(hidden), threshold, machine.catalogue.legs)


def _evidence_threshold(seen: Signatures, scoring: Scoring, level: float, seed: int) -> float:
    """Return the evidence that the best candidate exceeds on noise alone with a probability."""
    if not (isinstance(level, Real) and 0 < level < 1):
        raise InputError(f"level is a probability between 0 and 1, such as 0.01, not {level!r}")
    drawn = noise_residuals(seen, np.random.default_rng(check_integer("seed", seed, 0)), DRAWS)
    best = scoring.evidences(drawn).max(axis=0) if scoring.candidates else np.zeros(1)
    return float(np.quantile(best, 1 - level))


def _signature_cosines(seen: Signatures, single: Sequence[Candidate]) -> tuple[Array, Array]:
    """Return the lengths of signatures ``(k,)``, and cosines ``(k, k)`` between those of
    different effects.
    """
    columns = np.column_stack(
        [np.zeros((len(seen.residual), 0)), *(seen.signature(c) for c in single)]
    )
    length = np.linalg.norm(columns, axis=0)
    cosine = np.abs(columns.T @ columns) / np.multiply.outer(length, length)
    kinds = np.array([c.effect for c in single])
    cosine[np.equal.outer(kinds, kinds)] = 0.0  # members of one effect are no rivals here
    return length, cosine


def _smallest_sizes(length: float, cosine: float, threshold: float) -> tuple[float, float]:
    """Return the sizes that are detected and named, in tolerances."""
    detected = np.sqrt(noncentrality(length**2, threshold)) / length
    sine = np.sqrt(max(1 - cosine**2, 0.0))
    named = np.inf if sine < _MIN_SINE else required_separation() / (length * sine)
    return float(detected), float(max(detected, named))


def noncentrality(square: float, threshold: float) -> float:
    """Return the noncentrality at which an effect's evidence exceeds a threshold with the
    probability `POWER`; ``square`` is that of its signature at tolerance.
    """
    from scipy.special import chndtrinc

    limit = (2 * threshold + np.log1p(square)) * (1 + square) / square
    return float(chndtrinc(limit, 1, 1 - POWER)) if limit > 0 else 0.0


def required_separation() -> float:
    """Return the distance in sigmas from which the wrong fit's chi2 is larger by the width of a
    class.

    The difference of chi2 at distance D is normal with mean D^2 and standard deviation 2 D.
    """
    from scipy.special import ndtri

    z = float(ndtri(POWER))
    return z + float(np.sqrt(z**2 + INDISTINGUISHABLE_CHI2))
