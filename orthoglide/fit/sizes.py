"""The common scale of distances, by the numbers of the machine's file: how much larger a part is
than they have it, and whether its plastic's shrinkage says so.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orthoglide.fit.factors import Factor
from orthoglide.fit.problem import Problem
from orthoglide.instruments import PRINTED, SIZES
from orthoglide.notes import Note
from orthoglide.numerals import compact, signed
from orthoglide.observations import source

_BEYOND = 2.0  # sigmas: one part in twenty is off by more, if nothing is wrong
_LOOK = (
    "what is beyond that is of the rods, of the drives (belt pitch, microsteps), of the part or of "
    "the calliper: measure a rod between its holes, 100 mm of a carriage's travel, and a gauge "
    "block with the calliper, and give the first two under [measured] of the machine file"
)
_MEAN = "printed parts are {} ± {} % smaller than they were commanded"


def part_sizes(problem: Problem) -> Iterator[Note]:
    """Yield the measured scale of every file's printed parts with its standard deviation."""
    for factor in problem.tool:
        rows = [s.material == PRINTED for s in factor.readings.setups]
        printed = factor.readings.paired & np.array(rows)[factor.setup] & factor.noise.weighted
        if printed.sum() > 1:
            yield _size(problem, factor.subset(printed))


def _size(problem: Problem, factor: Factor) -> Note:
    """Return the scale of a printed part, by least squares with the offsets of its setups."""
    machine, (mean, sd) = problem.machine, SIZES[PRINTED]
    # Without what was identified or measured: the rods that the firmware has go with its radius.
    values = {n: e.value for n, e in machine.spec.parameters.items() if not e.sigma}
    here = factor.linearise(machine.model, values, ())
    nuisance = factor.nuisances(here.seen)
    # Scale is the only nuisance that setups have together, and stands first: nothing is taken as
    # known of it here.
    prior = np.where(np.arange(len(nuisance.sd)) == 0, 0.0, 1 / nuisance.sd)
    rows = np.vstack([nuisance.columns / factor.sigma[:, None], np.diag(prior)])
    aim = np.zeros(len(rows))
    aim[: len(factor.sigma)] = (factor.measured - here.value) / factor.sigma
    inverse = np.linalg.inv(rows.T @ rows)
    scale, sigma = float((inverse @ rows.T @ aim)[0]), float(np.sqrt(inverse[0, 0]))
    size = (1 - mean) * (1 + scale) - 1
    text = (
        f"{source(factor.readings)}: by the nominal numbers of the machine file, distances are "
        f"{signed(size * 1e2, 2)} ± {compact(sigma * 1e2, 1)} % longer than the tool went; "
        f"{_MEAN.format(compact(mean * 1e2, 1), compact(sd * 1e2, 1))}"
    )
    beyond = abs(scale) > _BEYOND * float(np.hypot(sigma, sd)) and not machine.spec.measured.rods
    return Note(f"{text}: {_LOOK}" if beyond else text, "size")
