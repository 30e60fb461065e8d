"""CasADi functions for many rows at once, compiled by the computer's C compiler, cached on disk."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import casadi as ca
import numpy as np

from orthoglide.geometry import Array

# Without contraction to fused multiply-add compiled code rounds as the interpreter does. The
# functions are straight lines of arithmetic: -O2 takes twice as long to compile and gains 5 %.
_FLAGS, _SHARED = ("-O1", "-ffp-contract=off"), ("-fPIC", "-shared")


def compiler() -> str | None:
    """Return the path of the C compiler: ``$CC``, cc, gcc or clang.

    It is ``None`` where there is none, or with ``ORTHOGLIDE_COMPILE=0`` in the environment.
    """
    if os.environ.get("ORTHOGLIDE_COMPILE", "1") == "0":
        return None
    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    return next((path for name in names if name and (path := shutil.which(name))), None)


def compiled(
    names: Sequence[str], key: str, build: Callable[[], list[Any]] | None
) -> list[Any] | None:
    """Return CasADi functions compiled to machine code, from the cache if possible.

    Args:
        names: of the functions.
        key: identifies the library; the functions depend on nothing else.
        build: returns the functions to compile; where absent, only the cache is used.

    Returns:
        The functions in the same order, or ``None`` where there is no compiler, it fails, or the
        cache is empty. Interpreted functions return the same numbers to the last bit.
    """
    path = library(f"{key} {ca.CasadiMeta.version()}", build)
    try:
        return None if path is None else [ca.external(name, str(path)) for name in names]
    except RuntimeError:  # the file system does not allow execution
        return None


def library(key: str, build: Callable[[], list[Any]] | None) -> Path | None:
    """Return the path of a compiled library, as :func:`compiled` finds or builds it.

    The compiler's target is part of its name, so different computers can share the cache.
    """
    if (command := compiler()) is None:
        return None
    try:
        described = "\n".join([key, command, *_FLAGS, _compiler_target(command)])
        folder, digest = _cache_folder(), _digest(described.encode())
        cached = _cached_library(folder, digest)
        if cached or build is None:
            return cached
        return _build_library(command, build(), folder, digest)
    except (OSError, subprocess.SubprocessError):
        return None


@cache
def _compiler_target(command: str) -> str:
    """Return the compiler's macros, which describe the computer that it compiles for."""
    command_line = [command, *_FLAGS, "-dM", "-E", "-x", "c", "-"]
    return subprocess.run(command_line, check=True, input="", capture_output=True, text=True).stdout


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24]


def _cache_folder() -> Path:
    """Return the folder of compiled functions, which only the user can write; make it if missing.

    It is ``$ORTHOGLIDE_CACHE``, else a folder in the user's cache folder.

    Raises:
        PermissionError: where it belongs to another user.
    """
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(os.environ.get("ORTHOGLIDE_CACHE") or Path(base) / "orthoglide")
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    status = folder.stat()
    if hasattr(os, "getuid"):
        if status.st_uid != os.getuid():
            raise PermissionError(f"{folder} belongs to another user")
        if status.st_mode & 0o022:
            folder.chmod(status.st_mode & 0o755)
    return folder


def _cached_library(folder: Path, digest: str) -> Path | None:
    """Return the cached library of a digest; a file that its name's checksum refutes is removed."""
    for library in sorted(folder.glob(f"closure-{digest}-*.so")):
        if library.stem.rpartition("-")[2] == _digest(library.read_bytes()):
            return library
        library.unlink()
    return None


def _build_library(command: str, functions: list[Any], folder: Path, digest: str) -> Path:
    generator = ca.CodeGenerator("closure", {"verbose": False})
    for function in functions:
        generator.add(function)
    with tempfile.TemporaryDirectory(dir=folder) as workspace:
        code, out = Path(workspace) / "closure.c", Path(workspace) / "closure.so"
        code.write_text(str(generator.dump()), encoding="utf-8")
        subprocess.run(
            [command, *_FLAGS, *_SHARED, str(code), "-o", str(out), "-lm"],
            check=True,
            capture_output=True,
            timeout=120,
        )
        library = folder / f"closure-{digest}-{_digest(out.read_bytes())}.so"
        out.replace(library)  # atomic, also where two processes build at once
    return library


_ROWS_PER_CALL = 256


def blocks(row_count: int, size: int = _ROWS_PER_CALL) -> Iterator[slice]:
    """Yield slices of rows, by default as many as one mapped call takes and the cache holds."""
    for start in range(0, row_count, size):
        yield slice(start, min(start + size, row_count))


class RowFunction:
    """A CasADi function of vectors, evaluated for rows of them; a lock guards its buffers.

    Args:
        function: of column vectors; its results are dense.
        shared: number of leading arguments that are common to all rows.
    """

    def __init__(self, function: Any, shared: int = 0) -> None:
        self.function, self._shared = function, shared
        # CasADi stores matrices by columns.
        outputs = range(function.n_out())
        self._shapes = [(function.size2_out(k), function.size1_out(k)) for k in outputs]
        self._buffers: dict[int, tuple[Any, Any]] = {}
        self._lock = Lock()

    def __call__(self, *arguments: Array) -> list[Array]:
        """Return results ``(n, rows)``, or ``(n, rows, columns)`` where they are matrices.

        Args:
            arguments: ``(k,)`` the shared ones, ``(n, k)`` the others; the last sets n.
        """
        evaluate = self._evaluate_row if len(arguments[-1]) == 1 else self._evaluate_rows
        with self._lock:
            return evaluate(*arguments)

    def _evaluate_rows(self, *arguments: Array) -> list[Array]:
        n, shared = len(arguments[-1]), self._shared
        values = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        results = [np.empty((n, *shape)) for shape in self._shapes]
        for part in blocks(n):
            buffer, evaluate = self._buffer(part.stop - part.start)
            for k, value in enumerate(values):
                buffer.set_arg(k, memoryview(value if k < shared else value[part]))  # type: ignore[arg-type]
            for k, result in enumerate(results):
                buffer.set_res(k, memoryview(result[part]))  # type: ignore[arg-type]
            evaluate()
        return [r[:, 0] if r.shape[1] == 1 else np.swapaxes(r, 1, 2) for r in results]

    def _evaluate_row(self, *arguments: Array) -> list[Array]:
        """Return the results of one row, copying arguments to the buffers of the function."""
        given, results, evaluate, _ = self.single
        for array, value in zip(given, arguments, strict=True):
            array[:] = value if value.ndim == 1 else value[0]
        evaluate()
        return [
            r[None].copy() if columns == 1 else r.reshape(1, columns, rows).swapaxes(1, 2).copy()
            for r, (columns, rows) in zip(results, self._shapes, strict=True)
        ]

    @cached_property
    def single(self) -> tuple[list[Array], list[Array], Callable[[], None], Any]:
        """Arguments to be written, results to be read, the evaluation between, and its buffer."""
        function = self.function
        arguments = [np.zeros(function.numel_in(k)) for k in range(function.n_in())]
        results = [np.zeros(function.numel_out(k)) for k in range(function.n_out())]
        buffer, evaluate = function.buffer()
        for k, array in enumerate(arguments):
            buffer.set_arg(k, memoryview(array))  # type: ignore[arg-type]
        for k, array in enumerate(results):
            buffer.set_res(k, memoryview(array))  # type: ignore[arg-type]
        return arguments, results, evaluate, buffer

    def _buffer(self, size: int) -> tuple[Any, Any]:
        if size not in self._buffers:
            name, same = f"{self.function.name()}_{size}", list(range(self._shared))
            self._buffers[size] = self.function.map(name, "serial", size, same, []).buffer()
        return self._buffers[size]


class CompilableFunctions:
    """Functions of rows, interpreted until ``worth`` rows make compiling worthwhile, compiled at
    once or never.

    ``key`` identifies compiled libraries, see `compiled`; ``build`` returns the CasADi functions,
    of whose leading arguments ``shared`` are common to all rows.
    """

    def __init__(
        self,
        names: Sequence[str],
        key: str,
        build: Callable[[], list[Any]],
        shared: int,
        worth: int,
        compile: bool | None = None,
    ) -> None:
        self._names, self._key, self._build = tuple(names), key, build
        self._shared, self._rows_evaluated = shared, 0
        self._compile_after = -1 if compile is False else worth
        self._rows: dict[str, RowFunction] = {}
        self.compiled = compile is not False and self._use_functions(compiled(names, key, None))
        if compile:
            self.compile()

    def _use_functions(self, functions: list[Any] | None) -> bool:
        if functions is None:
            return False
        self._rows = {
            name: RowFunction(function, self._shared)
            for name, function in zip(self._names, functions, strict=True)
        }
        return True

    def __call__(self, name: str, *arguments: Array) -> list[Array]:
        """Return the results of function ``name`` for rows, as :class:`RowFunction` does."""
        self._rows_evaluated += len(arguments[-1])
        if not self.compiled and 0 <= self._compile_after <= self._rows_evaluated:
            self.compile()
        return self.rows(name)(*arguments)

    def rows(self, name: str) -> RowFunction:
        """Return a function in its current form, compiled or not."""
        if not self._rows:
            self._use_functions(self._build())
        return self._rows[name]

    def compile(self) -> None:
        """Compile the functions now if there is a compiler."""
        self.compiled = self._use_functions(compiled(self._names, self._key, self._build))
        self._compile_after = -1  # tried once
