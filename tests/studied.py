"""A closed loop as the search left it, for tests that look at its fits and what it weighed."""

from typing import Any

from orthoglide.closing import Closed, close
from orthoglide.verdict import requested


def studied(*given: Any, **options: Any) -> Closed:
    """Close the loop as ``og.close_loop`` does with the same arguments, and keep the fits."""
    return close(requested(*given, **options))
