"""The base fit at which readings are linearised: without a slip, or why it does not close."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from orthoglide.errors import ClosureError, NumericsError, SolverError
from orthoglide.explanation.corrections import with_faults_accounted_for
from orthoglide.explanation.mixture import Mixture
from orthoglide.fit import Estimate, Problem
from orthoglide.fit.notes import tolerance_notes
from orthoglide.fit.solving import solve
from orthoglide.geometry import Array
from orthoglide.ordering import LOG_ODDS_MARGIN, best_of, descending

_MOST_EXCLUDED = 12
"""Readings that are left out in turn, the likeliest slips first: among more readings than these,
one slip drives a fit less far off."""

_LEAST_LEVERAGE = 0.5
"""Share of a reading in its own prediction from which a fit follows its slip more than all others
show it; a slip of less leverage leaves most of itself in its residual."""

_MAX_LIMITS_NAMED = 3  # parameters that a message names


def fit_nested(problem: Problem, start: Array | None = None) -> Estimate:
    """Return the fit of readings in doubt, with priors as they stand; ``start``: ``(P,)``, SI."""
    return solve(problem, method="nested", start=start, widen=False)


def fits_without_a_slip(before: Estimate, mixture: Mixture) -> list[Estimate]:
    """Return the fit at the parameters of the one reading less that leaves the smallest chi2, as a
    list; empty if no reading that the fit follows may be a slip.

    Where readings are few, a slip of millimetres drives a fit to where the readings are far from
    linear, and any other of them seems to have slipped.
    """
    groups, odds = mixture.linear.groups, mixture.log_posterior_odds_if_sound().max(axis=1)
    faults = [groups[k].source.fault for k in descending(odds) if groups[k].of_data]
    fits = list[Estimate]()
    is_followed = before.rows.leverage > _LEAST_LEVERAGE
    faults = [fault for fault in faults if fault.excluded and is_followed[fault.rows].any()]
    for fault in faults[:_MOST_EXCLUDED]:
        with suppress(NumericsError):
            problem = with_faults_accounted_for(before.problem, [fault])
            fits.append(fit_nested(problem))
    best = [best_of(fits, lambda fit: -fit.scores.chi2, LOG_ODDS_MARGIN)] if fits else []
    return [replace(before, x=fit.x) for fit in best]


@contextmanager
def closure_explained(before: Estimate) -> Iterator[None]:
    """Replace an error of closure by a message that says why, and what to do."""
    try:
        yield
    except ClosureError as error:
        exceeded = exceeded_limits(before)
        named, further = exceeded[:_MAX_LIMITS_NAMED], len(exceeded) - _MAX_LIMITS_NAMED
        limits = "; ".join([*named, f"and {further} more"] if further > 0 else named)
        raise SolverError(
            f"the identified machine does not reach all of its stroke: {limits}. If it cannot be "
            "so far off, correct the unit of the readings, or a size in the machine file (such as "
            "a diameter given as a radius); if it can, correct the machine, or give a shorter "
            "stroke"
            if limits
            else "the identified machine does not close: the readings, or their units, are not "
            "those of this machine"
        ) from error


def exceeded_limits(estimate: Estimate) -> list[str]:
    """Return a clause for each base parameter that is far beyond its tolerance."""
    return [note.partition(":")[0] for note in tolerance_notes(estimate, uncertain=True)]
