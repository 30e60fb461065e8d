"""Linear algebra on one thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

_P = ParamSpec("_P")
_R = TypeVar("_R")


def on_one_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the function with linear algebra on one thread while it runs.

    Its matrices are small: on several cores synchronisation takes up to ten times as long as the
    work itself. The number of threads of the calling program does not change.
    """

    @wraps(function)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with threadpool_limits(1, user_api="blas"):  # of the libraries that are loaded by now
            return function(*args, **kwargs)

    return wrapper
