"""Closure of many postures at once: CasADi functions mapped, and compiled where it pays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import ClosureError, UnreachableError
from orthoglide.geometry import Array
from orthoglide.mechanism import seed
from orthoglide.mechanism.functions import (
    LINES,
    ROTATION,
    TCP,
    ClosureFunctions,
    closure_functions,
    rigid_rows,
)
from orthoglide.mechanism.lanes import Lanes, lanes
from orthoglide.mechanism.mapped import Mapped
from orthoglide.mechanism.tree import Tree

CLOSED = 1e-11
"""Largest closure residual, metres and radians, that counts as closed."""

# A side, m^6 or m^5, whose sign is chosen by rounding: carriages in one line, or in one plane with
# the tool or the origin. A millimetre from there it is ten thousand times as large.
_FLAT = 1e-20

JUMPED = 100.0
"""Sum of the joints' squared angles, rad^2, from which Newton's method has jumped, perhaps to a
wrong posture: of 20,000 all over the stroke of each of three linear deltas no right one had 75 but
by whole turns, and the wrong ones had thousands.
"""

# Compiling takes seconds once: as much as this many postures have cost by then.
_WORTH_COMPILING = 20_000


# Postures that choose the order in which compiled closures eliminate.
_SAMPLES = 32


def _closed(residual: Array) -> NDArray[np.bool_]:
    """Which rows ``(N,)`` of a residual ``(N, n)`` count as closed."""
    return np.asarray(np.max(np.abs(residual), axis=1, initial=0.0) <= CLOSED)


@contextmanager
def placed(shape: tuple[int, ...]) -> Iterator[None]:
    """Errors from within name their place in a batch of ``shape`` that was flattened."""
    try:
        yield
    except (ClosureError, UnreachableError) as error:
        if error.index:
            error.index = tuple(int(k) for k in np.unravel_index(error.index[0], shape))
        raise


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
        self._plain: dict[str, Any] = self._build()
        self._interpreted = {name: Mapped(function) for name, function in self._plain.items()}
        self._functions: Mapping[str, Mapped | Lanes] = self._interpreted
        self._pending, self._asked = compile is None, 0
        self.compiled = False
        if compile is not False:
            self._compile(build=bool(compile))

    def _build(self) -> dict[str, Any]:
        """CasADi functions of (unknowns, what is known), by name."""
        return vars(closure_functions(self.tree, self.tree.free, self._rows))

    @property
    def _rows(self) -> tuple[int, ...]:
        """Rows of the 21 that are solved: all with relief joints, else independent ones."""
        return tuple(range(21)) if len(self.tree.relief) else rigid_rows(self.tree)

    def _known(self, given: Array) -> Array:
        """What the functions take for given."""
        return np.asarray(given, dtype=float)

    def _compile(self, *, build: bool) -> None:
        found = self._compiled(build)
        if found is not None:
            self._functions, self.compiled, self._pending = found, True, False
        elif build:
            self._pending = False

    def _compiled(self, build: bool) -> Mapping[str, Mapped | Lanes] | None:
        plain = ClosureFunctions(**self._plain)
        return lanes(plain.residual, plain.outputs, plain.side, self._samples, build=build)

    def _samples(self) -> tuple[Array, Array]:
        """Unknowns and what is known of postures all over the workspace, neutral first."""
        draws = np.random.default_rng(0)
        known = np.zeros((_SAMPLES, self._plain["close"].size1_in(1)))
        known[1:, :3] = draws.uniform(*self.tree.geometry.stroke, (_SAMPLES - 1, 3))
        x, residual, _ = self._interpreted["close"](np.zeros(self._size), known)
        closed = _closed(residual)
        return x[closed], known[closed]

    @property
    def _size(self) -> int:
        """How many unknowns there are."""
        return int(self._plain["close"].size1_out(0))

    def _call(self, name: str, x: Array, known: Array) -> list[Array]:
        self._count(len(known))
        return self._functions[name](x, known)

    def _count(self, postures: int) -> None:
        self._asked += postures
        if self._pending and self._asked >= _WORTH_COMPILING:
            self._compile(build=True)

    def single(self, start: Array, given: Array) -> tuple[Array, Array, int, Outputs] | None:
        """One posture by compiled code, closed or not.

        Args:
            start: unknowns ``(n,)`` to start from.
            given: ``(3 + m,)``.

        Returns:
            Unknowns, their residual, Newton's steps and what the posture shows; ``None`` where
            nothing is compiled.
        """
        self._count(1)
        if not self.compiled:
            return None
        x, residual, _, steps, shown = self._functions["posture"](start, given[None])
        return x[0], residual[0], int(steps[0, 0]), Outputs(shown[0])

    def _solved(
        self, start: Array, known: Array, mode: seed.Mode
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Unknowns where Newton's method ends, the residual, and which rows closed in ``mode``."""

        def right() -> NDArray[np.bool_]:
            here = side[:, 0] < -_FLAT if mode == "machine" else side[:, 0] > _FLAT
            return _closed(residual) & here & (side[:, 1] < JUMPED)

        x, residual, side = self._call("close", start, known)[:3]
        done = right()
        # What is interpreted chooses its pivots as it goes.
        for functions in (self._functions, self._interpreted):
            if done.all():
                break
            again = np.flatnonzero(~done)
            near = self._seed(np.broadcast_to(start, x.shape)[again], known[again], mode)
            x[again], residual[again], side[again] = functions["close"](near, known[again])[:3]
            done = right()
        return x, residual, done

    def _seed(self, start: Array, known: Array, mode: seed.Mode) -> Array:
        """Perfect legs' joints where those meet, else ``start`` ``(N, n)``."""
        near, p = start.copy(), seed.tool(self.tree.geometry, known[:, :3], mode)
        near[:, : len(self.tree.free)] = seed.free_joints(self.tree, known[:, :3], p)
        return np.where(np.isfinite(p[:, :1]), near, start)

    def close(self, given: Array, guess: Array | None = None, mode: seed.Mode = "machine") -> Array:
        """Unknowns that close the loops.

        Args:
            given: ``(N, 3 + m)``.
            guess: unknowns to start from, ``(N, n)``; the assembled neutral posture by default.
            mode: assembly mode. What ends elsewhere starts again from perfect legs.

        Returns:
            ``(N, n)``: free joints in the order of ``tree.free``, radians.

        Raises:
            ClosureError: naming the first posture that does not close in this assembly mode, with
                its residual by loop.
        """
        known, start = self._known(given), np.zeros(self._size) if guess is None else guess
        x, residual, done = self._solved(start, known, mode)
        if not done.all():
            bad = np.flatnonzero(~done)
            raise self._failure(int(bad[0]), residual[bad[0]], len(bad), known)
        return x

    def _failure(self, index: int, residual: Array, count: int, known: Array) -> ClosureError:
        full = np.zeros(21)
        full[list(self._rows)] = residual
        by_loop = self.tree.by_loop(full)
        worst = max(by_loop, key=lambda name: np.nan_to_num(by_loop[name], nan=np.inf))
        how = (
            "which closes only in the other assembly mode or where the two meet"
            if by_loop[worst] <= CLOSED
            else f"with its largest misfit of {by_loop[worst] * 1e3:.3g} mm or mrad at {worst}"
        )
        return ClosureError(
            f"{count} of {len(known)} postures do not close; the first is number {index}, {how}"
            f"{self._counted_from_zero(known[index, :3])}",
            residuals=by_loop,
            index=(index,),
        )

    def _counted_from_zero(self, travel: Array) -> str:
        """A hint where a command would be within the stroke if it were travel."""
        geometry = self.tree.geometry
        zero = geometry.zero
        if not zero.any() or not geometry.in_stroke(travel + 2 * zero).all():
            return ""
        return f": at mechanical zero every command is {zero[0]:g} m, not 0"

    def outputs(self, x: Array, given: Array) -> Outputs:
        """What postures show, for unknowns ``(N, n)`` as :meth:`close` returns them."""
        return Outputs(self._call("outputs", x, self._known(given))[0])

    def tangent(self, x: Array, given: Array) -> tuple[Outputs, Array]:
        """What postures show and how it moves while the loops stay closed.

        Returns:
            Outputs, and their derivative ``(N, 48, 3 + m)`` by what is given.
        """
        values, by_given = self._call("tangent", x, self._known(given))
        return Outputs(values), by_given
