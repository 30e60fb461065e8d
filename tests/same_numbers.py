"""Comparison of two results as decoded JSON: equal but for rounding."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

SAME, TINY = 1e-6, 1e-9  # relative, and in the units of files: what processors round otherwise
OF_SOLVERS = ("iterations", "last_step_in_sigmas")  # of any fit


def leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of a nested mapping with the place where it stands."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from leaves(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            yield from leaves(inner, f"{place}[{k}]")
    else:
        yield place, value


def compare(old: Any, new: Any) -> Iterator[str]:
    """Where two results differ by more than rounding."""
    before, after = (
        {place: one for place, one in leaves(every) if not place.endswith(OF_SOLVERS)}
        for every in (old, new)
    )
    for place in dict.fromkeys((*before, *after)):
        one, other = before.get(place, "gone"), after.get(place, "gone")
        if not same(one, other):
            yield f"{place} was {one!r} and is {other!r}"


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal, numbers to rounding or as neighbours of six digits."""
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in (one, other)):
        return bool(one == other)
    if math.isclose(one, other, rel_tol=SAME, abs_tol=TINY):
        return True
    if any(float(f"{v:.6g}") != v or v == 0 for v in (one, other)):
        return False
    digit = 10.0 ** (math.floor(math.log10(min(abs(one), abs(other)))) - 5)
    return bool(abs(one - other) < 1.5 * digit)
