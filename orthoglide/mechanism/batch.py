"""Closure of many postures at once: CasADi functions mapped, and compiled where it pays."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from orthoglide.errors import ClosureError, UnreachableError
from orthoglide.geometry import Array
from orthoglide.mechanism.compiled import compiled
from orthoglide.mechanism.functions import (
    LINES,
    OUTPUTS,
    RIGID_ROWS,
    ROTATION,
    TCP,
    closure_functions,
)
from orthoglide.mechanism.tree import Tree

CLOSED = 1e-11
"""Largest closure residual, metres and radians, that counts as closed."""

_CHUNK = 256
# Compiling takes two seconds once: as much as this many postures have cost by then.
_WORTH_COMPILING = 20_000


@contextmanager
def placed(shape: tuple[int, ...]) -> Iterator[None]:
    """Errors from within name their place in a batch of ``shape`` that was flattened."""
    try:
        yield
    except (ClosureError, UnreachableError) as error:
        if error.index:
            error.index = tuple(int(k) for k in np.unravel_index(error.index[0], shape))
        raise


def view(array: Array) -> Any:
    """An array as CasADi's buffers take it."""
    return memoryview(array)  # type: ignore[arg-type]


def blocks(count: int) -> Iterator[slice]:
    """Rows in pieces that one mapped call takes and the cache holds."""
    for start in range(0, count, _CHUNK):
        yield slice(start, min(start + _CHUNK, count))


class Outputs:
    """What a posture shows: views into an array ``(..., 48)``.

    Attributes:
        values: the array itself.
    """

    def __init__(self, values: Array) -> None:
        self.values = values

    @property
    def p(self) -> Array:
        """TCP ``(..., 3)``, metres."""
        return self.values[..., TCP]

    @property
    def R(self) -> Array:
        """Rotation of the platform ``(..., 3, 3)``."""
        return self.values[..., ROTATION].reshape(*self.values.shape[:-1], 3, 3)

    @property
    def lines(self) -> Array:
        """Ends of the bars ``(..., leg, bar, end, 3)``, carriage's end first, metres."""
        return self.values[..., LINES].reshape(*self.values.shape[:-1], 3, 2, 2, 3)


class BatchClosure:
    """Closes the loops of one tree for batches ``(N, ...)`` of postures.

    What is *given* of a posture is ``[drive (3); virtual (m)]``: travel of the drives from
    mechanical zero and displacements of the virtual joints, metres and radians.

    Args:
        tree: nominal (rigid legs) or general (with relief and virtual joints).
        compile: ``True`` to compile at once, ``False`` never, ``None`` once many postures have been
            asked for or an earlier run has left a compiled copy. Without a C compiler nothing
            changes but speed.
    """

    def __init__(self, tree: Tree, *, compile: bool | None = None) -> None:
        self.tree = tree
        self._plain = self._build()
        self._functions: dict[str, Any] = vars(self._plain).copy()
        self._mapped: dict[tuple[str, int], tuple[Any, Any]] = {}
        self._pending, self._asked = compile is None, 0
        self.compiled = False
        if compile is not False:
            self._compile(build=bool(compile))

    def _build(self) -> Any:
        """A dataclass of CasADi functions of (unknowns, what is given)."""
        rows = None if len(self.tree.relief) else RIGID_ROWS
        return closure_functions(self.tree, self.tree.free, rows)

    def _compile(self, *, build: bool) -> None:
        names = list(self._functions)
        found = compiled([getattr(self._plain, name) for name in names], build=build)
        if found is not None:
            self._functions = dict(zip(names, found, strict=True))
            self._mapped = {}
            self.compiled, self._pending = True, False
        elif build:
            self._pending = False

    def _call(self, name: str, x: Array, given: Array, *shapes: tuple[int, ...]) -> list[Array]:
        """Evaluate a function for all rows; outputs of the given shapes, column-major in CasADi."""
        n = len(given)
        self._asked += n
        if self._pending and self._asked >= _WORTH_COMPILING:
            self._compile(build=True)
        results = [np.empty((n, *shape[::-1])) for shape in shapes]
        x, given = np.ascontiguousarray(x, dtype=float), np.ascontiguousarray(given, dtype=float)
        for part in blocks(n):
            buffer, evaluate = self._buffer(name, part.stop - part.start)
            buffer.set_arg(0, view(x[part]))
            buffer.set_arg(1, view(given[part]))
            for k, result in enumerate(results):
                buffer.set_res(k, view(result[part]))
            evaluate()
        return [np.moveaxis(r, 1, -1) if r.ndim == 3 else r for r in results]

    def _buffer(self, name: str, size: int) -> tuple[Any, Any]:
        key = (name, size)
        if key not in self._mapped:
            self._mapped[key] = self._functions[name].map(size).buffer()
        return self._mapped[key]

    def close(self, given: Array, guess: Array | None = None) -> Array:
        """Free joints that close the loops.

        Args:
            given: ``(N, 3 + m)``.
            guess: free joints to start from, ``(N, n)``; the assembled neutral posture by default.

        Returns:
            Free joints ``(N, n)``, radians, in the order of ``tree.free``.

        Raises:
            ClosureError: naming the first posture that does not close, with its residual by loop.
        """
        size = len(self.tree.free)
        start = np.zeros((len(given), size)) if guess is None else np.asarray(guess, dtype=float)
        (x,) = self._call("close", start, given, (size,))
        (residual,) = self._call("residual", x, given, (size,))
        worst = np.max(np.abs(residual), axis=1, initial=0.0)
        bad = np.flatnonzero(~(worst <= CLOSED))
        if bad.size:
            raise self._failure(int(bad[0]), residual[bad[0]], len(bad), len(given))
        return x

    def _failure(self, index: int, residual: Array, count: int, total: int) -> ClosureError:
        full = np.zeros(21)
        full[list(RIGID_ROWS) if len(residual) == len(RIGID_ROWS) else slice(None)] = residual
        by_loop, start = {}, 0
        for loop in self.tree.loops:
            size = 3 if loop.kind == "point" else 6
            by_loop[loop.name] = float(np.max(np.abs(full[start : start + size])))
            start += size
        worst = max(by_loop, key=lambda name: np.nan_to_num(by_loop[name], nan=np.inf))
        return ClosureError(
            f"{count} of {total} postures do not close; the first is number {index}, with its "
            f"largest misfit of {by_loop[worst] * 1e3:.3g} mm or mrad at {worst}",
            residuals=by_loop,
            index=(index,),
        )

    def outputs(self, x: Array, given: Array) -> Outputs:
        """What postures show, for free joints ``(N, n)`` as :meth:`close` returns them."""
        return Outputs(self._call("outputs", x, given, (OUTPUTS,))[0])

    def tangent(self, x: Array, given: Array) -> tuple[Outputs, Array]:
        """What postures show and how it moves while the loops stay closed.

        Returns:
            Outputs, and their derivative ``(N, 48, 3 + m)`` by the given drives and virtual joints.
        """
        values, by_given = self._call("tangent", x, given, (OUTPUTS,), (OUTPUTS, given.shape[1]))
        return Outputs(values), by_given
