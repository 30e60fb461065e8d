"""Linear algebra on one thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

_Function = TypeVar("_Function", bound=Callable[..., Any])


def on_one_thread(function: _Function) -> _Function:
    """Return the function with linear algebra on one thread while it runs.

    Its matrices are small: on several cores synchronisation takes up to ten times as long as the
    work itself. The number of threads of the calling program does not change.
    """
    wrapped: _Function = threadpool_limits.wrap(limits=1, user_api="blas")(function)
    return wrapped
