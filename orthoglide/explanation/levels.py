"""A level that counts in the opposite direction, is read about the other axis, or shows degrees.

Zeros and leg lengths do not turn the platform, so the base model fits such readings equally well,
and causes that turn it are found for them. Only the evidence of the full model prefers the correct
interpretation.
"""

from __future__ import annotations

import numpy as np

from orthoglide.errors import InputError
from orthoglide.explanation.alternative_readings import sharing_prior
from orthoglide.explanation.faults import Fault, weighted_rows
from orthoglide.explanation.full_posterior import posterior_at_base_fit
from orthoglide.explanation.ranked_readings import likeliest_misreading
from orthoglide.fit import Estimate, Problem
from orthoglide.observations import source

_DEGREE = np.pi / 180 / 1e-3  # a reading in degrees that was taken for milliradians

_BACKGROUND_SCALES = ((5.0, 0.003),)
"""What turns the platform is often off by many tolerances, and must not count against it."""


def check_levels(estimate: Estimate) -> None:
    """Refuse readings of levels that are far likelier with another interpretation than as they
    stand, both at their base fits. More readings than `ranked_readings` compares are not checked.

    Raises:
        InputError: names file and setups, the interpretation, and what to do.
    """
    problem = estimate.problem
    setups = np.unique(problem.setup_of_row[problem.angular]).tolist()
    if not setups:
        return
    interpretations = _interpretations(problem)
    alternatives = sharing_prior(interpretations.values())
    rows_by_setup = {s: weighted_rows(problem, s) for s in setups}
    found = likeliest_misreading(
        estimate, posterior_at_base_fit(estimate), alternatives, rows_by_setup,
        background_scales=_BACKGROUND_SCALES,
    )  # fmt: skip
    if found is not None:
        files = [source(f.readings) for f in problem.factors for _ in f.readings.setups]
        names = "; ".join(f"{files[s]}, setup {problem.setups[s].name!r}" for s in setups)
        pairs = zip(interpretations, alternatives, strict=True)
        clause = next(clause for clause, fault in pairs if fault is found)
        raise InputError(
            f"{names}: the readings of the level have a far likelier machine, and fit it, {clause}"
        )


def _interpretations(problem: Problem) -> dict[str, Fault]:
    """Return other interpretations of the readings of all levels, by how they fit then, and what to
    do.
    """
    rows = np.flatnonzero(problem.angular)
    axis = problem.column("axis")[rows]
    interpretations = {
        "with the opposite sign: look which way it counts, right-handed about x and y, and put -x "
        "and -y as directions": Fault("sign", rows, -1.0),
        "with x and y exchanged: correct the directions": Fault("exchanged_labels", rows, 1.0),
        "as degrees: put them into milliradians, 17.45 a degree": Fault("unit", rows, _DEGREE),
    }
    for k, name in enumerate("xy" if len(np.unique(axis)) > 1 else ""):
        clause = f"with the opposite sign about {name}: look which way it counts there, and put "
        interpretations[f"{clause}-{name} as direction"] = Fault("sign", rows[axis == k], -1.0)
    return interpretations
