"""The findings of the search as values of a result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from orthoglide.closing.actions import confirmation_test, may_be_lost_motion
from orthoglide.effects import Catalogue
from orthoglide.effects.wording import cause_short, size_words
from orthoglide.explanation import Cause, Curve, Explanation, Located
from orthoglide.explanation.change import Change
from orthoglide.explanation.data_faults import ReportedFault
from orthoglide.fit import Estimate
from orthoglide.numerals import SIGMAS_95
from orthoglide.observations import Readings
from orthoglide.result import findings, fits, residuals

MAX_DRAWN_CAUSES = 4
"""Causes of a credible set that one figure shows; more lines cannot be distinguished."""

RequestRow = Callable[[int, int], int]
"""From the number of the readings and a row of the fit to the row within the request's readings."""


def explanation_value(one: Explanation, drawn: bool = False) -> findings.Explanation:
    """Return the value of an explanation; its predicted readings only where they are drawn."""
    value, sigma = one.estimate_in_unit or (float("nan"), float("nan"))
    effect, width = one.catalogue.effect_of(one.name), ""
    if one.estimate_in_unit is not None:
        width = size_words(effect, sigma * effect.unit.si * SIGMAS_95)
    return findings.Explanation(
        one.name, tuple(map(str, one.parameters)), float(value), float(sigma), one.unit,
        float(one.probability), one.words, one.look_at, confirmation_test(one), width,
        _plain_floats(one.values), _plain_floats(one.sigmas), one.shown if drawn else np.zeros(0),
    )  # fmt: skip


def _plain_floats(values: Mapping[str, float]) -> dict[str, float]:
    return {str(name): float(value) for name, value in values.items()}


def cause_value(cause: Cause) -> findings.Cause:
    """Return the value of a cause with its credible set."""
    drawn = {id(one) for one in cause.explanations[:MAX_DRAWN_CAUSES]}
    chosen, rivals, same = (
        tuple(explanation_value(one, id(one) in drawn) for one in some)
        for some in ((cause.chosen,), cause.rivals, cause.same)
    )
    return findings.Cause(chosen[0], rivals, same, tuple(map(_curve_value, cause.places)), may_be_lost_motion(cause),
                       cause.data)  # fmt: skip


def located_value(one: Located, catalogue: Catalogue) -> findings.Located:
    """Return the value of a located error.

    Args:
        one: the located error.
        catalogue: effects of the calibrated machine.
    """
    resembling, ruled_out = (
        tuple(cause_short(catalogue, name) for name in some)
        for some in (one.resembling, one.ruled_out)
    )
    return findings.Located(
        tuple(map(_curve_value, one.members)), float(one.probability), tuple(one.resembling), resembling,
        ruled_out, one.in_machine(catalogue)[0], may_be_lost_motion(one), one.data,
    )  # fmt: skip


def _curve_value(curve: Curve) -> findings.Curve:
    place = curve.place
    legs = place.names.legs
    return findings.Curve(
        name=place.name,
        leg=legs[place.leg] if place.leg >= 0 else None,
        part=place.part,
        direction=place.direction or None,
        against=place.against,
        short_waves=place.short_waves,
        by_leg=legs[place.command_drive] if place.against == "command" else None,
        setup=place.setup or None,
        probability=float(curve.probability),
        unit=curve.unit,
        description=place.words,
        size=curve.size,
        size_words=curve.size_words,
        at=curve.at,
        value=curve.value,
        sigma=curve.sigma,
        of_dial=place.of_dial,
        of_machine=place.of_machine,
    )


def data_fault_value(
    blunder: ReportedFault, given: Sequence[Readings], row: RequestRow
) -> residuals.DataFault:
    """Return the value of a data fault.

    Args:
        blunder: the data fault.
        given: readings in which it was found.
        row: returns the row within the readings of the request, from the number of the readings and
            the row within ``given``.
    """
    lines = blunder.lines(given)
    return residuals.DataFault(
        kind=blunder.kind,
        rows=tuple(line for rows in lines.values() for line in rows),
        files={name.rpartition("/")[2]: rows for name, rows in lines.items()},
        setups=blunder.setups,
        message=blunder.message,
        improvement=float(blunder.improvement),
        rms_with=float(blunder.rms_with),
        rms_without=float(blunder.rms_without),
        rows_in_request=tuple((k, row(k, r)) for k, r in blunder.rows),
        excluded=blunder.excluded,
    )


def change_value(change: Change, covered: bool) -> residuals.Change:
    """Return the value of a change.

    Args:
        change: the change.
        covered: whether a cause in the same result already reports it.
    """
    si = change.unit.si
    return residuals.Change(
        parameter=str(change.parameter),
        members=tuple(map(str, change.members)),
        before=change.before / si,
        after=change.after / si,
        sigma=change.sigma / si,
        unit=change.unit.name,
        files=change.files,
        message=change.message,
        vague=change.vague,
        when=change.when,
        what=change.what,
        each=change.member_clauses,
        evidence=float(change.evidence),
        loses=may_be_lost_motion(change),
        covered_by_cause=covered,
    )


def fit_value(fit: Estimate) -> fits.Fit:
    """Return the value of a fit."""
    return fits.Fit(
        fit.scores, _plain_floats(fit.values), _plain_floats(fit.sigmas), float(fit.sigma_scale),
        fit.coverage_factor, tuple(map(str, fit.on_bound)), fit.method, int(fit.iterations),
        float(fit.optimality), fit.warnings,
    )  # fmt: skip
