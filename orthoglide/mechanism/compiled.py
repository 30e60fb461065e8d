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
    digest = hashlib.sha256("\n".join([source, command, *_FLAGS]).encode()).hexdigest()[:24]
    try:
        library = cache_folder() / f"closure-{digest}.so"
        if not library.exists():
            if not build:
                return None
            _build(command, source, library)
        return [ca.external(f.name(), str(library)) for f in functions]
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return None


def _source(functions: Sequence[Any]) -> str:
    generator = ca.CodeGenerator("closure", {"verbose": False})
    for function in functions:
        generator.add(function)
    return str(generator.dump())


def _build(command: str, source: str, library: Path) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        code, out = Path(folder) / "closure.c", Path(folder) / "closure.so"
        code.write_text(source, encoding="utf-8")
        subprocess.run(
            [command, *_FLAGS, str(code), "-o", str(out), "-lm"],
            check=True,
            capture_output=True,
            timeout=120,
        )
        out.replace(library)  # whole or not at all, also where two processes build at once
