"""CasADi functions compiled by the C compiler of the machine, where it has one; cached on disk."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca

_FLAGS = ("-O2", "-fPIC", "-shared")


def compiler() -> str | None:
    """Path of the C compiler: ``$CC``, cc, gcc or clang; ``None`` where there is none.

    ``ORTHOGLIDE_COMPILE=0`` in the environment says not to use it.
    """
    if os.environ.get("ORTHOGLIDE_COMPILE", "1") == "0":
        return None
    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    return next((path for name in names if name and (path := shutil.which(name))), None)


def cache_folder() -> Path:
    """Where compiled functions are kept: ``$ORTHOGLIDE_CACHE``, else the user's cache folder."""
    chosen = os.environ.get("ORTHOGLIDE_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "orthoglide"


def compiled(functions: Sequence[Any], *, build: bool = True) -> list[Any] | None:
    """The same functions, compiled.

    Args:
        functions: CasADi functions without free symbols, of distinct names.
        build: whether to compile where the cache has nothing.

    Returns:
        The functions in the same order, or ``None`` where there is no compiler, it fails, or the
        cache is empty and ``build`` is false: the caller goes on with what it has.
    """
    command = compiler()
    if command is None:
        return None
    source = _source(functions)
    digest = _digest("\n".join([source, command, *_FLAGS]).encode())
    try:
        folder = _own_folder()
        library = _library(folder, digest)
        if library is None:
            if not build:
                return None
            library = _build(command, source, folder, digest)
        return [ca.external(f.name(), str(library)) for f in functions]
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return None


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24]


def _own_folder() -> Path:
    """The cache, made where it is missing, that nobody but the user can write to.

    Raises:
        PermissionError: where it is another's.
    """
    folder = cache_folder()
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    found = folder.stat()
    if hasattr(os, "getuid"):
        if found.st_uid != os.getuid():
            raise PermissionError(f"{folder} belongs to another user")
        if found.st_mode & 0o022:
            folder.chmod(found.st_mode & 0o755)
    return folder


def _library(folder: Path, digest: str) -> Path | None:
    """The compiled library of a source, whose name tells its content: a damaged one is removed."""
    for library in sorted(folder.glob(f"closure-{digest}-*.so")):
        if library.stem.rpartition("-")[2] == _digest(library.read_bytes()):
            return library
        library.unlink()
    return None


def _source(functions: Sequence[Any]) -> str:
    generator = ca.CodeGenerator("closure", {"verbose": False})
    for function in functions:
        generator.add(function)
    return str(generator.dump())


def _build(command: str, source: str, folder: Path, digest: str) -> Path:
    with tempfile.TemporaryDirectory(dir=folder) as made:
        code, out = Path(made) / "closure.c", Path(made) / "closure.so"
        code.write_text(source, encoding="utf-8")
        subprocess.run(
            [command, *_FLAGS, str(code), "-o", str(out), "-lm"],
            check=True,
            capture_output=True,
            timeout=120,
        )
        library = folder / f"closure-{digest}-{_digest(out.read_bytes())}.so"
        out.replace(library)  # whole or not at all, also where two processes build at once
    return library
