"""The border between files and SI: units, exact conversion, and files read or written whole.

A number in a file is a decimal; it becomes SI by shifting its decimal point and is rounded to
binary once. Writing shifts the shortest decimal back. So 310.25 mm is read as the float nearest
to 0.31025 m and written as 310.25 again, and every round trip is exact.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

from orthoglide.errors import FileError, InputError


class Unit(NamedTuple):
    """A unit of files: its name and what it is worth in SI (a power of ten)."""

    name: str
    si: float


MM, RAD, ONE = Unit("mm", 1e-3), Unit("rad", 1.0), Unit("1", 1.0)

FAMILIES: dict[str, tuple[Unit, float]] = {
    "joint_offset": (MM, 2.0),
    "leg_length": (MM, 0.05),
    "axis_tilt": (RAD, 1e-3),
    "axis_offset": (MM, 0.3),
    "mount_tilt": (RAD, 2e-3),
    "bar_mismatch": (MM, 0.05),
    "parallelogram_width": (MM, 0.1),
    "rail_bow": (MM, 0.02),
    "rail_tilt": (RAD, 1e-3),
    "encoder_scale": (ONE, 1e-4),
    "screw_error": (MM, 0.01),
    "backlash": (MM, 0.02),
    "drive_compliance": (Unit("mm/N", 1e-3), 1e-4),
    "thermal_growth": (Unit("1/K", 1.0), 5e-6),
    "thermal_drift": (Unit("1/s", 1.0), 1e-8),
    "gauge_scale": (ONE, 0.01),
    "gauge_direction": (RAD, 0.02),
    "gauge_drift": (Unit("mm/s", 1e-3), 2e-5),
}
"""Families of effects: their parameters' unit, and the default tolerance in that unit."""

UNITS: dict[str, Unit] = {family: unit for family, (unit, _) in FAMILIES.items()}
"""Unit of every family: ``(name, SI factor)``."""


def unit_of(parameter: str) -> Unit:
    """Unit of a parameter such as ``joint_offset.x`` or of a family.

    Raises:
        InputError: where there is no such family.
    """
    family = parameter.partition(".")[0]
    if family not in UNITS:
        raise InputError(f"there is no family {family!r}: it is one of {', '.join(UNITS)}")
    return UNITS[family]


def to_si(number: str | int | float | Decimal, factor: float = 1.0) -> float:
    """The SI value nearest to a decimal given in a unit worth ``factor`` (a power of ten)."""
    return float(Decimal(str(number)).scaleb(_places(factor)))


def from_si(value: float, factor: float = 1.0) -> Decimal:
    """The shortest decimal in a unit worth ``factor`` that `to_si` turns back into ``value``."""
    return Decimal(f"{Decimal(repr(float(value))).scaleb(-_places(factor)):f}")


def _places(factor: float) -> int:
    return Decimal(repr(factor)).adjusted()


DEFAULT_TOLERANCE: dict[str, float] = {
    family: to_si(value, unit.si) for family, (unit, value) in FAMILIES.items()
}
"""Default standard deviation to expect of every family, SI."""


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """A file's content; a missing, empty or unreadable one is a `FileError`."""
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        raise FileError("there is no such file: check the name", file=str(path)) from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FileError(
            f"cannot be read ({reason}): give a readable file", file=str(path)
        ) from None
    if not content.strip():
        raise FileError("is empty: give a file with content", file=str(path))
    return content


_BINARY = {
    b"PK\x03\x04": "is a spreadsheet or archive: export the sheet as CSV (UTF-8)",
    b"\xd0\xcf\x11\xe0": "is an old spreadsheet: export the sheet as CSV (UTF-8)",
    b"\xff\xfe": "is UTF-16 text: save it as UTF-8",
    b"\xfe\xff": "is UTF-16 text: save it as UTF-8",
}


def decode(content: bytes, path: str | os.PathLike[str]) -> str:
    """UTF-8 text with or without byte order mark; anything else is a `FileError`."""
    for start, message in _BINARY.items():
        if content.startswith(start):
            raise FileError(message, file=str(path))
    if b"\0" in content:
        raise FileError("is not text: give a UTF-8 text file", file=str(path))
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise FileError("is not UTF-8 text: save it as UTF-8", file=str(path), line=line) from None


def sha256(content: bytes) -> str:
    """Digest of a file's content, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def write_whole(path: str | os.PathLike[str], text: str, *, overwrite: bool) -> None:
    """Writes a text file that appears whole or not at all.

    Args:
        path: where to.
        text: what; encoded as UTF-8.
        overwrite: whether an existing file may be replaced.

    Raises:
        FileError: where a file stands already and may not be replaced, or none can be written.
    """
    target = Path(path)
    if target.exists() and not overwrite:
        raise FileError("exists and is not overwritten: choose another name", file=str(path))
    try:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FileError(
            f"cannot be written ({reason}): choose another place", file=str(path)
        ) from None
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
            stream.write(text)
        os.chmod(name, 0o644)  # mkstemp's file is its owner's alone
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
