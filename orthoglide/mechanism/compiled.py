"""CasADi functions compiled by the C compiler of the machine, where it has one; cached on disk."""

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
    """Path of the C compiler: ``$CC``, cc, gcc or clang; ``None`` where there is none.

    ``ORTHOGLIDE_COMPILE=0`` in the environment says not to use it.
    """
    if os.environ.get("ORTHOGLIDE_COMPILE", "1") == "0":
        return None
    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    return next((path for name in names if name and (path := shutil.which(name))), None)


def compiled(
    names: Sequence[str], key: str, build: Callable[[], list[Any]] | None
) -> list[Any] | None:
    """Return CasADi functions compiled to machine code, from the cache where they are.

    Args:
        names: of the functions.
        key: tells libraries apart; the functions depend on nothing else.
        build: returns the functions to compile; where absent, only the cache is looked at.

    Returns:
        The functions in the same order, or ``None`` where there is no compiler, it fails, or the
        cache has nothing: the caller goes on with interpreted functions, which return the same
        numbers to the last bit.
    """

    def source() -> str:
        generator = ca.CodeGenerator("closure", {"verbose": False})
        for function in build() if build else []:
            generator.add(function)
        return str(generator.dump())

    path = library(f"{key} {ca.CasadiMeta.version()}", source, _FLAGS, build=build is not None)
    try:
        return None if path is None else [ca.external(name, str(path)) for name in names]
    except RuntimeError:  # where nothing may be run from the cache
        return None


def library(
    content: str, source: Callable[[], str], flags: Sequence[str], *, build: bool
) -> Path | None:
    """The compiled library of a source, from the cache where it is.

    Args:
        content: tells sources apart.
        source: writes it, in C.
        flags: of the compiler. Where they ask for this computer's own instructions, other kinds of
            computer that share the cache have libraries of their own.
        build: whether to compile where the cache has nothing.

    Returns:
        ``None`` where there is no compiler, it fails, or the cache is empty and ``build`` false.
    """
    command = compiler()
    if command is None:
        return None
    try:
        digest = _digest(
            "\n".join([content, command, *flags, _compiler_target(command, tuple(flags))]).encode()
        )
        folder = _cache_folder()
        found = _cached_library(folder, digest)
        return (
            found
            if found or not build
            else _build_library(command, flags, source(), folder, digest)
        )
    except (OSError, subprocess.SubprocessError):
        return None


@cache
def _compiler_target(command: str, flags: tuple[str, ...]) -> str:
    """What the compiler says of the computer that these flags compile for."""
    asked = [command, *flags, "-dM", "-E", "-x", "c", "-"]
    return subprocess.run(asked, check=True, input="", capture_output=True, text=True).stdout


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24]


def _cache_folder() -> Path:
    """Where compiled functions are kept, made where it is missing, and nobody but the user can
    write: ``$ORTHOGLIDE_CACHE``, else in the user's cache folder.

    Raises:
        PermissionError: where it is another's.
    """
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(os.environ.get("ORTHOGLIDE_CACHE") or Path(base) / "orthoglide")
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    found = folder.stat()
    if hasattr(os, "getuid"):
        if found.st_uid != os.getuid():
            raise PermissionError(f"{folder} belongs to another user")
        if found.st_mode & 0o022:
            folder.chmod(found.st_mode & 0o755)
    return folder


def _cached_library(folder: Path, digest: str) -> Path | None:
    """The compiled library of a source, whose name tells its content: a damaged one is removed."""
    for library in sorted(folder.glob(f"closure-{digest}-*.so")):
        if library.stem.rpartition("-")[2] == _digest(library.read_bytes()):
            return library
        library.unlink()
    return None


def _build_library(
    command: str, flags: Sequence[str], source: str, folder: Path, digest: str
) -> Path:
    with tempfile.TemporaryDirectory(dir=folder) as made:
        code, out = Path(made) / "closure.c", Path(made) / "closure.so"
        code.write_text(source, encoding="utf-8")
        subprocess.run(
            [command, *flags, *_SHARED, str(code), "-o", str(out), "-lm"],
            check=True,
            capture_output=True,
            timeout=120,
        )
        library = folder / f"closure-{digest}-{_digest(out.read_bytes())}.so"
        out.replace(library)  # whole or not at all, also where two processes build at once
    return library
