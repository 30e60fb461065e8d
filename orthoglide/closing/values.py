"""The findings of the search as values of a result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from orthoglide.closing.actions import confirmation_test, may_be_lost_motion
from orthoglide.effects import Catalogue
from orthoglide.effects.wording import cause_short, size_words
from orthoglide.explanation import Cause, Curve, Explanation, Located
from orthoglide.explanation.change import Change
from orthoglide.explanation.data_faults import ReportedFault
from orthoglide.numerals import SIGMAS_95
from orthoglide.observations import Readings
from orthoglide.result import findings, residuals

MAX_DRAWN_CAUSES = 4
"""Causes of a credible set that one figure shows; more lines cannot be distinguished."""

RequestRow = Callable[[int, int], int]
"""From the number of the readings and a row of the fit to the row within the request's readings."""

T = TypeVar("T")


def value_of(cls: type[T], source: object, **others: Any) -> T:
    """Return an instance of a dataclass of a result.

    Args:
        cls: the dataclass.
        source: object with the attributes that are copied under the same names.
        others: values of all other fields.
    """
    names = (f.name for f in fields(cls) if f.name not in others)  # type: ignore[arg-type]
    return cls(**{name: getattr(source, name) for name in names}, **others)


def explanation_value(explanation: Explanation, drawn: bool = False) -> findings.Explanation:
    """Return the value of an explanation; its predicted readings only if they are drawn."""
    value, sigma = explanation.estimate_in_unit or (float("nan"), float("nan"))
    effect, half_width = explanation.catalogue.effect_of(explanation.name), ""
    if explanation.estimate_in_unit is not None:
        half_width = size_words(effect, sigma * effect.unit.si * SIGMAS_95)
    return value_of(
        findings.Explanation, explanation, value=value, sigma=sigma, half_width=half_width,
        confirm=confirmation_test(explanation), shown=explanation.shown if drawn else np.zeros(0),
    )  # fmt: skip


def cause_value(cause: Cause) -> findings.Cause:
    """Return the value of a cause with its credible set."""
    drawn = {id(explanation) for explanation in cause.explanations[:MAX_DRAWN_CAUSES]}
    chosen, rivals, same = (
        tuple(explanation_value(explanation, id(explanation) in drawn) for explanation in members)
        for members in ((cause.chosen,), cause.rivals, cause.same)
    )
    return findings.Cause(
        chosen[0], rivals, same, places=tuple(map(_curve_value, cause.places)),
        loses=may_be_lost_motion(cause), data=cause.data,
    )  # fmt: skip


def located_value(located: Located, catalogue: Catalogue) -> findings.Located:
    """Return the value of a located error; ``catalogue``: effects of the calibrated machine."""
    resembling, ruled_out = (
        tuple(cause_short(catalogue, name) for name in names)
        for names in (located.resembling, located.ruled_out)
    )
    return value_of(
        findings.Located, located, members=tuple(map(_curve_value, located.members)),
        resembling_words=resembling, ruled_out=ruled_out,
        in_budget=located.in_machine(catalogue)[0], loses=may_be_lost_motion(located),
    )  # fmt: skip


def _curve_value(curve: Curve) -> findings.Curve:
    place, legs = curve.place, curve.place.names.legs
    return value_of(
        findings.Curve,
        curve,
        leg=legs[place.leg] if place.leg >= 0 else None,
        part=place.part,
        direction=place.direction or None,
        against=place.against,
        short_waves=place.short_waves,
        by_leg=legs[place.command_drive] if place.against == "command" else None,
        setup=place.setup or None,
        description=place.words,
        of_dial=place.of_dial,
        of_machine=place.of_machine,
    )


def data_fault_value(
    fault: ReportedFault, readings: Sequence[Readings], request_row: RequestRow
) -> residuals.DataFault:
    """Return the value of a data fault.

    Args:
        fault: the data fault.
        readings: readings in which it was found.
        request_row: returns the row within the readings of the request, from the number of the
            readings and the row within ``readings``.
    """
    lines = fault.lines(readings)
    return value_of(
        residuals.DataFault,
        fault,
        rows=tuple(line for rows in lines.values() for line in rows),
        files={name.rpartition("/")[2]: rows for name, rows in lines.items()},
        rows_in_request=tuple((k, request_row(k, r)) for k, r in fault.rows),
    )


def change_value(change: Change, covered: bool) -> residuals.Change:
    """Return the value of a change; ``covered``: whether a cause in the same result reports it."""
    si = change.unit.si
    return value_of(
        residuals.Change, change, before=change.before / si, after=change.after / si,
        sigma=change.sigma / si, unit=change.unit.name, each=change.member_clauses,
        loses=may_be_lost_motion(change), covered_by_cause=covered,
    )  # fmt: skip
