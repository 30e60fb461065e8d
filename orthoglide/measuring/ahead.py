"""A computation that runs while somebody reads a dial."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


def begun(compute: Callable[[], T]) -> Future[T]:
    """Begin at once; a process that ends does not wait for it, as it would for a pool."""
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(compute())
        except BaseException as error:  # raised again where the result is wanted
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future
