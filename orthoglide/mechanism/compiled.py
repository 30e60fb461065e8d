"""CasADi functions compiled by the C compiler of the computer, cached on disk."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca

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
