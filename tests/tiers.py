"""Cases of the first tier: what every run of the tests takes of a long table."""

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import pytest


def in_turn(
    names: Sequence[Any], values: Sequence[Any], group: Callable[[Any], Hashable] | None = None
) -> list[Any]:
    """Return all pairs of a name and a value, most of them marked thorough.

    The first tier has one pair of each name: the first name has the first value, the second name
    the second one, and so on round the values. With ``group`` it has one pair of each group, of
    the group's first name, the next group's second name, and so on round the names.
    """
    groups: dict[Hashable, list[Any]] = {}
    for name in names:
        groups.setdefault(name if group is None else group(name), []).append(name)
    first = {
        (members[k % len(members)], values[k % len(values)])
        for k, members in enumerate(groups.values())
    }
    return [
        pytest.param(name, value, marks=[] if (name, value) in first else pytest.mark.thorough)
        for name in names
        for value in values
    ]
