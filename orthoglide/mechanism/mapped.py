"""CasADi functions evaluated for many rows at once, without a loop in Python."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from orthoglide.geometry import Array

_CHUNK = 256


def blocks(count: int, size: int = _CHUNK) -> Iterator[slice]:
    """Rows in pieces, by default such that one mapped call takes and the cache holds."""
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


class Mapped:
    """A CasADi function of vectors, for rows of them. Holds buffers: one object serves one thread.

    Args:
        function: of column vectors; its results are dense.
    """

    def __init__(self, function: Any) -> None:
        self.function = function
        # CasADi stores columns.
        self._shapes = [
            (function.size2_out(k), function.size1_out(k)) for k in range(function.n_out())
        ]
        self._buffers: dict[int, tuple[Any, Any]] = {}

    def __call__(self, *arguments: Array) -> list[Array]:
        """Results ``(n, rows)``, or ``(n, rows, columns)`` where they are matrices.

        Args:
            arguments: each ``(n, k)``, or ``(k,)`` where all rows share it; the last sets n.
        """
        n = len(arguments[-1])
        rows = [
            np.ascontiguousarray(
                a if len(np.shape(a)) == 2 else np.broadcast_to(a, (n, len(a))), dtype=float
            )
            for a in arguments
        ]
        results = [np.empty((n, *shape)) for shape in self._shapes]
        for part in blocks(n):
            size = part.stop - part.start
            if size not in self._buffers:
                self._buffers[size] = self.function.map(size).buffer()
            buffer, evaluate = self._buffers[size]
            for k, row in enumerate(rows):
                buffer.set_arg(k, memoryview(row[part]))  # type: ignore[arg-type]
            for k, result in enumerate(results):
                buffer.set_res(k, memoryview(result[part]))  # type: ignore[arg-type]
            evaluate()
        return [r[:, 0] if r.shape[1] == 1 else np.swapaxes(r, 1, 2) for r in results]
