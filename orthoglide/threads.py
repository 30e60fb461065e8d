"""Linear algebra on one thread."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


@contextmanager
def _one_thread() -> Iterator[None]:
    with threadpool_limits(1, user_api="blas"):  # of the libraries that are loaded by now
        yield


on_one_thread = _one_thread()
"""Decorates functions whose linear algebra runs on one thread.

Their matrices are small: on several cores synchronisation takes up to ten times as long as the work
itself. The number of threads of the calling program does not change.
"""
