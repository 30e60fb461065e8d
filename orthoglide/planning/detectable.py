"""The smallest effects that a protocol would find, and the smallest that it could name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.diagnosis.evidence import Scoring
from orthoglide.diagnosis.ranking import CLASS_WIDTH
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.diagnosis.significance import DRAWS, noise_residuals
from orthoglide.effects import BASE_FAMILIES, family_of
from orthoglide.fit import Estimate, solve
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign
from orthoglide.planning.expected import expected, expected_noise

POWER = 0.95
"""Probability with which an effect of the size stated is found, or named."""

_ALIKE = 1e-3  # sine between signatures that no size of effect would tell apart


@dataclass(frozen=True)
class Smallest:
    """What a protocol makes of one candidate.

    Attributes:
        name: of the candidate.
        tolerance: of its parameter, SI.
        unit: of its parameter in files.
        detectable: size that is found with 95 % probability, SI.
        nameable: size at which no other family fits as well, with 95 % probability, SI; infinite
            where one always does.
        nearest: candidate of another family that is hardest to tell from it; empty: there is none.
    """

    name: str
    tolerance: float
    unit: str
    detectable: float
    nameable: float
    nearest: str


@dataclass(frozen=True)
class Detectability:
    """What a protocol makes of the whole catalogue.

    Attributes:
        smallest: by candidate of one parameter, in the order of the catalogue.
        invisible: parameters that these readings cannot show, whatever their size within reason.
        threshold: evidence that noise alone exceeds with the probability asked for.
    """

    smallest: tuple[Smallest, ...]
    invisible: tuple[str, ...]
    threshold: float


def smallest_effects(
    machine: Machine,
    campaign: Campaign,
    *,
    families: Sequence[str] = (),
    level: float = 0.01,
    noise: float | None = None,
    seed: int = 0,
) -> Detectability:
    """Sizes of effect that a protocol detects and names with 95 % probability.

    An effect of v tolerances with signature S has the evidence ``(w X - log(1 + |S|^2)) / 2``, X
    noncentral chi-squared with one degree of freedom and noncentrality ``v^2 |S|^2``,
    ``w = |S|^2 / (1 + |S|^2)``. It is detected above the evidence that the best of the catalogue
    reaches on noise with probability ``level``. It is named where the best fit of every other
    family is worse by a chi2 of 4.

    Args:
        machine: as it is believed to be.
        campaign: stations and setups; readings do not count.
        families: to report; all where empty. The catalogue competes whole in any case.
        level: family-wise probability of a false alarm.
        noise: standard deviation of one reading, metres.
        seed: of the bootstrap on noise.
    """
    seen = signatures(_as_expected(machine, campaign, noise))
    scoring = Scoring.of(seen, seen.candidates)
    drawn = noise_residuals(seen, np.random.default_rng(seed), DRAWS)
    best = scoring.evidences(drawn).max(axis=0) if scoring.candidates else np.zeros(1)
    threshold = float(np.quantile(best, 1 - level))
    single = [k for k, c in enumerate(scoring.candidates) if c.size == 1]
    shown = np.column_stack(
        [np.zeros((len(seen.residual), 0)), *(seen.of(scoring.candidates[k]) for k in single)]
    )
    found = []
    for place, k in enumerate(single):
        candidate = scoring.candidates[k]
        if not families or candidate.effect in families or candidate.name in families:
            found.append(_smallest(machine, seen, scoring, shown, single, place, threshold))
    wanted = [n for n in seen.invisible if not families or family_of(n).name in families]
    return Detectability(tuple(found), tuple(wanted), threshold)


def _as_expected(machine: Machine, campaign: Campaign, noise: float | None) -> Estimate:
    """The base model identified from the readings predicted for it."""
    level = expected_noise(machine, campaign, noise)
    return solve(expected(machine, campaign, BASE_FAMILIES, level).problem, method="nested")


def _smallest(
    machine: Machine,
    seen: Signatures,
    scoring: Scoring,
    shown: Array,
    single: list[int],
    place: int,
    threshold: float,
) -> Smallest:
    candidate = scoring.candidates[single[place]]
    own = shown[:, place]
    length = float(np.linalg.norm(own))
    tolerance = float(np.abs(seen.scaled(candidate)).max())
    others = [k for k, c in enumerate(single) if scoring.candidates[c].effect != candidate.effect]
    sine, nearest = 1.0, ""
    if others:
        rest = shown[:, others]
        cosine = np.abs(rest.T @ own) / (np.linalg.norm(rest, axis=0) * length)
        closest = int(np.argmax(cosine))
        sine = float(np.sqrt(max(1 - cosine[closest] ** 2, 0.0)))
        nearest = scoring.candidates[single[others[closest]]].name
    detected = np.sqrt(noncentrality(length**2, threshold)) / length
    named = np.inf if sine < _ALIKE else separation() / (length * sine)
    return Smallest(
        candidate.name,
        tolerance,
        family_of(candidate.name).unit.name,
        float(detected * tolerance),
        float(max(detected, named) * tolerance),
        nearest,
    )


def noncentrality(square: float, threshold: float, power: float = POWER) -> float:
    """Noncentrality at which an effect's evidence exceeds a threshold with some probability.

    Args:
        square: of the signature at tolerance.
        threshold: of the evidence.
        power: the probability.
    """
    from scipy.special import chndtrinc

    limit = (2 * threshold + np.log1p(square)) * (1 + square) / square
    return float(chndtrinc(limit, 1, 1 - power)) if limit > 0 else 0.0


def separation(power: float = POWER) -> float:
    """Distance in sigmas from which the wrong fit's chi2 is larger by the width of a class.

    The difference of chi2 at distance D is normal with mean D^2 and standard deviation 2 D.
    """
    from scipy.special import ndtri

    z = float(ndtri(power))
    return z + float(np.sqrt(z**2 + CLASS_WIDTH))
