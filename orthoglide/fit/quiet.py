"""Readings that agree with a fit far better than their noise lets expect.

An instrument may be better than was assumed. But readings in a unit that is too large, as inches
or degrees, are small numbers, and so is what a fit leaves of them: the machine looks sound.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

import numpy as np

from orthoglide.fit.estimate import Estimate
from orthoglide.fit.noise_scales import NoiseScale, noise_scales, together
from orthoglide.fit.problem import Problem
from orthoglide.notes import Note
from orthoglide.numerals import compact
from orthoglide.observations import source

# Ratios of residual scatter to assumed noise below which a note is given. Inches are 25 times too
# small and degrees 57 times, but unmodelled errors of the machine remain in the residual, so the
# limit is a tenth; a fifth for noise that was declared, which is not as wrong as a usual figure.
_QUIET, _QUIET_OF_DECLARED = 0.1, 0.2
_FEWEST = 10.0  # degrees of freedom: noise alone leaves a tenth of itself once in 4e8 such setups
_EXACT = 1e-8  # metres or radians: whose noise is declared this small is not measured but computed
_DECLARED, _FROM_REPEATS = "as declared", "from their repeats"
_FROM_FILE, _IN_FILE = "as the machine file has it", " in the machine file, "
_HALF = 2.0  # times that noise may be declared too large without a word
_CHANCE = 1e-3  # of readings with half of the noise declared that are said to be too quiet
_MOST = 1e3  # times quieter, from which the figure says nothing more


def quieter(estimate: Estimate) -> tuple[Note, ...]:
    """Sentences on readings that are too quiet: by instrument, or else all together."""
    return tuple(_by_instrument(estimate)) or tuple(_all_together(estimate))


def _by_instrument(estimate: Estimate) -> Iterator[Note]:
    """A sentence for every setup of an instrument at the tool, and for all dials of a file, that is
    left with next to nothing of its noise.
    """
    problem = estimate.problem
    for table, several in groupby(noise_scales(estimate), key=lambda one: one.readings):
        each = list(several)
        dials = bool(table.on_legs.all())
        for noise in [together(each)] if dials else each:
            origin = _origin(problem, noise)
            limit = _QUIET_OF_DECLARED if origin else _QUIET
            # Dials with declared noise are tested by `_all_together`.
            counted = dials and problem.noise.source == "declared"
            known = noise.sigma >= _EXACT and noise.dof >= _FEWEST
            if not counted and known and noise.scale < limit:
                yield Note(_sentence(noise, origin), "quiet")


def _all_together(estimate: Estimate) -> Iterator[Note]:
    """Readings that scatter so much less than was declared that the figure must be wrong: a chi2
    that would be too small even if they had half of that noise.
    """
    from scipy.special import chdtr

    problem, scores = estimate.problem, estimate.scores
    told = all(np.isfinite(f.readings.sigma).all() for f in problem.tool if problem.on_legs)
    if problem.noise.source != "declared" or not told or estimate.sigma_scale > 1:
        return
    if chdtr(max(scores.dof, 1e-9), _HALF**2 * scores.chi2) < _CHANCE:
        times = np.sqrt(scores.dof / max(scores.chi2, 1e-300))
        yield Note(
            f"the readings scatter {compact(times, 2)} times less than the noise that was declared "
            f"({problem.one_reading.said()}; chi2 {compact(scores.chi2, 2)} on "
            f"{scores.dof:.0f} degrees of freedom), so that faults may go unnoticed: correct the "
            f"declared noise, or the unit of the readings",
            "quiet",
        )


def _sentence(noise: NoiseScale, origin: str) -> str:
    """What was found of some readings, and what to do."""
    table, setup = noise.readings, noise.setup
    unit, other = ("mrad", "degrees") if setup.observation.angular else ("mm", "inches")
    times = 1 / max(noise.scale, 1 / _MOST)
    count = f"more than {_MOST:.0f}" if times >= _MOST else compact(times, 2)
    where = source(table)
    if table.on_legs.all():
        place = f"{_IN_FILE}[dial_mm]"
    elif table.by_point:
        place = " in a column sigma_mm"
    else:
        where, place = f"{where}, setup {setup.name!r}", f"{_IN_FILE}[instrument.{setup.kind}]"
    return (
        f"{where}: the readings are {count} times quieter than the noise assumed of them "
        f"({compact(noise.sigma * 1e3, 2)} {unit}, {origin or 'the usual figure'}): are they in "
        f"another unit, as {other}? If not, "
        f"{'correct' if origin else 'declare'} the instrument's noise"
        f"{'' if origin == _DECLARED else place}"
    )


def _origin(problem: Problem, noise: NoiseScale) -> str:
    """Where the noise assumed comes from, in words; empty if it is what is usual of the kind."""
    spec = problem.machine.spec
    if noise.readings.on_legs.all():
        if problem.noise.source == "repeats":
            return _FROM_REPEATS
        return _FROM_FILE if spec.dial.repeatability else ""
    table, kind = noise.readings, noise.setup.kind
    own = np.array([s.kind == kind for s in table.setups])[table.setup]
    declared = problem.noise.source == "declared" and not problem.campaigns
    if declared or np.isfinite(table.sigma[own]).all():
        return _DECLARED
    instrument = spec.instruments.get(kind)
    return _FROM_FILE if instrument is not None and instrument.repeatability else ""
