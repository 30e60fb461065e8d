"""Cases of the first tier: what every run of the tests takes of a long table."""

from collections.abc import Sequence
from typing import Any

import pytest


def in_turn(names: Sequence[Any], values: Sequence[Any]) -> list[Any]:
    """Return all pairs of a name and a value; all but one pair of each name are thorough.

    The first name has the first value, the second name the second one, and so on round the values:
    each name and each value is in the first tier.
    """
    return [
        pytest.param(name, value, marks=[] if k % len(values) == j else pytest.mark.thorough)
        for k, name in enumerate(names)
        for j, value in enumerate(values)
    ]
