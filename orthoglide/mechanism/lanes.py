"""Closure compiled to straight-line code that takes several postures at once.

What CasADi has as expressions becomes C whose numbers are vectors, one posture a lane, for the
instructions of the computer it is compiled on. Newton's step and the tangent solve their linear
systems in an order of pivots chosen beforehand; ``lanes.c`` has what stands around them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import Any

import casadi as ca
import numpy as np

from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.mechanism.compiled import library
from orthoglide.mechanism.elimination import pivots, solve

_OPERATIONS = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_NEG: "-{}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1 / {}",
}
# More optimising gains a tenth and takes half as long again.
_FLAGS = ("-O1", "-march=native")
_WRITERS = ("lanes.c", "lanes.py", "elimination.py")
_PART = 300  # instructions of one function in C
_ON_THE_WAY = (0.0, 0.5, 1.0, 1.2)


class Lanes:
    """A compiled function of unknowns and what is known, for rows of them.

    Args:
        function: of the library.
        sizes: of unknowns and what is known.
        shapes: of its results.
    """

    def __init__(
        self, function: Any, sizes: tuple[int, int], shapes: Sequence[tuple[int, ...]]
    ) -> None:
        count, rows = ctypes.c_long, ctypes.c_void_p
        function.argtypes, function.restype = (count, rows, count, rows, rows), None
        self._function = function
        self._sizes = sizes
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes]).tolist()
        self._width = ends[-1]
        self._parts = [
            (slice(end - int(np.prod(shape)), end), shape)
            for end, shape in zip(ends, shapes, strict=True)
        ]

    def __call__(self, x: Array, known: Array) -> list[Array]:
        """Results ``(n, ...)`` for unknowns ``(n, k)``, or ``(k,)`` of all, and known ``(n, m)``.

        Raises:
            InputError: for another shape.
        """
        x, known = np.ascontiguousarray(x, dtype=float), np.ascontiguousarray(known, dtype=float)
        rows = len(known)
        wide = known.shape[1:] == self._sizes[1:]
        if not wide or x.shape not in ((self._sizes[0],), (rows, self._sizes[0])):
            raise InputError(f"a closure of {self._sizes} numbers got {x.shape} and {known.shape}")
        found = np.empty((rows, self._width))
        stride = self._sizes[0] if x.ndim == 2 else 0
        self._function(rows, x.ctypes.data, stride, known.ctypes.data, found.ctypes.data)
        return [found[:, part].reshape(rows, *shape) for part, shape in self._parts]


def lanes(
    residual: Any,
    outputs: Any,
    side: Any,
    samples: Callable[[], tuple[Array, Array]],
    *,
    build: bool,
) -> dict[str, Lanes] | None:
    """Functions by the names of ``ClosureFunctions``, compiled; ``close`` finds the unknowns, their
    residual, the side and the number of Newton's steps, ``posture`` also the outputs.

    Args:
        residual: SX function of (free, known), as many rows as are free.
        outputs: SX function of the same.
        side: SX function of the same.
        samples: closed postures, free ``(S, n)`` and known ``(S, m)``: they choose the pivots.
        build: whether to compile where the cache has nothing.

    Returns:
        ``None`` where there is no compiler, it fails, or the cache is empty and is to remain so.
    """
    n, m, count = residual.size1_in(0), residual.size1_in(1), outputs.size1_out(0)
    here = files("orthoglide.mechanism")
    own = [here.joinpath(name).read_text("utf-8") for name in _WRITERS]
    functions = residual, outputs, side
    content = "".join([*own, *(function.serialize() for function in functions)])
    path = library(content, lambda: _source(*functions, samples()), _FLAGS, build=build)
    if path is None:
        return None
    shapes: dict[str, list[tuple[int, ...]]] = {
        "close": [(n,), (n,), (2,), (1,)],
        "posture": [(n,), (n,), (2,), (1,), (count,)],
        "residual": [(n,)],
        "outputs": [(count,)],
        "tangent": [(count,), (count, m)],
    }
    try:
        found = ctypes.CDLL(str(path))
    except OSError:  # where nothing may be run from the cache
        return None
    return {name: Lanes(found[f"{name}_each"], (n, m), of) for name, of in shapes.items()}


def _source(residual: Any, outputs: Any, side: Any, samples: tuple[Array, Array]) -> str:
    x, known = ca.SX.sym("x", residual.size1_in(0)), ca.SX.sym("known", residual.size1_in(1))
    g, out = residual(x, known), outputs(x, known)
    by_x = ca.jacobian(g, x)
    order = _order(ca.Function("by_x", [x, known], [by_x]), *samples)
    moved = -solve(by_x, ca.jacobian(g, known), order)
    by_known = ca.densify(ca.jacobian(out, known) + ca.jacobian(out, x) @ moved)
    written = {
        "residual": [g],
        "outputs": [out],
        "side": [side(x, known)],
        "step": [ca.densify(solve(by_x, g, order))],
        "tangent": [out, ca.vec(by_known.T)],
    }
    close = 2 * x.numel() + 3
    sizes = {
        "close": close,
        "posture": close + out.numel(),
        **{k: sum(p.numel() for p in v) for k, v in written.items()},
    }
    head = files("orthoglide.mechanism").joinpath("lanes.c").read_text("utf-8")
    return "\n".join(
        [
            f"#define UNKNOWNS {x.numel()}\n#define KNOWN {known.numel()}\n{head}",
            *(_written(name, x, known, ca.vertcat(*parts)) for name, parts in written.items()),
            *(
                f"EACH({name}, {size})"
                for name, size in sizes.items()
                if name not in ("step", "side")
            ),
            "",
        ]
    )


def _order(by_x: Any, x: Array, known: Array) -> list[tuple[int, int]]:
    """Pivots for postures on the way from neutral to the samples, and a little beyond."""
    values = [np.array(by_x(s * a, b)) for a, b in zip(x, known, strict=True) for s in _ON_THE_WAY]
    filled = np.zeros(by_x.size_out(0), dtype=bool)
    filled[tuple(map(list, by_x.sparsity_out(0).get_triplet()))] = True
    return pivots(np.array(values), filled)


def _written(name: str, x: Any, known: Any, result: Any) -> str:
    """An expression as a function in C: CasADi's instructions on its work vector, one by one."""
    function = ca.Function(name, [x, known], ca.cse([result]))
    size, lines = function.sz_w(), []
    turned: dict[int, int] = {}  # where the sine of a place's present value is, the cosine behind
    for k in range(function.n_instructions()):
        operation, taken = function.instruction_id(k), function.instruction_input(k)
        to, place = function.instruction_output(k), taken[0] if taken else 0
        if operation == ca.OP_OUTPUT:
            lines.append(f"found[{to[1]}] = w[{place}];")
            continue
        if operation in (ca.OP_SIN, ca.OP_COS):
            if place not in turned:
                lines.append(f"turn(w + {place}, w + {size}, w + {size + 1});")
                turned[place], size = size, size + 2
            value = f"w[{turned[place] + (operation == ca.OP_COS)}]"
        elif operation == ca.OP_INPUT:
            value = f"{('x', 'known')[place]}[{taken[1]}]"
        elif operation == ca.OP_CONST:
            value = f"zero + {float(function.instruction_constant(k))!r}"
        else:
            value = _OPERATIONS[operation].format(*(f"w[{place}]" for place in taken))
        turned.pop(to[0], None)
        lines.append(f"w[{to[0]}] = {value};")
    return _in_parts(name, lines, size)


def _in_parts(name: str, lines: list[str], size: int) -> str:
    """Many short functions and one that calls them: long ones take compilers too long."""
    numbers = ", ".join(f"real *restrict {k}" for k in ("found", "w"))
    head = "(const real *restrict x, const real *restrict known, "
    parts = [
        f"static __attribute__((noinline)) void {name}_{k}{head}{numbers})\n{{\n"
        + "\n".join(lines[k : k + _PART])
        + "\n}\n"
        for k in range(0, len(lines), _PART)
    ]
    calls = [f"{name}_{k}(x, known, found, w);\n" for k in range(0, len(lines), _PART)]
    whole = f"static void {name}{head}real *restrict found)\n{{\nreal w[{size}];\n"
    return "".join([*parts, whole, *calls, "}\n"])
