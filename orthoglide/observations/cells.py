"""What a cell of a table may be: how its text becomes SI, and how SI becomes its text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from orthoglide import units
from orthoglide.quantities import Kind
from orthoglide.units import ONE, Unit

NAN = float("nan")

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_LONGEST_LABEL = 100
_LARGEST = 1e9  # in the unit of a column, far beyond any reading


def number(unit: Unit = ONE, low: float = -_LARGEST, high: float = _LARGEST) -> Kind:
    """Return the kind of a number between two limits in its unit; nan is an empty cell."""

    def read(cell: str) -> float:
        if not NUMBER.fullmatch(cell):
            if _NOT_FINITE.fullmatch(cell):
                raise ValueError("not a finite number: measure again, or remove the row")
            raise ValueError("not a number: write it like 12.34, without its unit")
        if not low <= float(cell) <= high:
            raise ValueError(f"which is out of range: give a number from {low:g} to {high:g}")
        return units.to_si(cell, unit.si)

    def write(value: float) -> str:
        return "" if value != value else str(units.from_si(value, unit.si))

    unlimited = (low, high) == (-_LARGEST, _LARGEST)
    return Kind(
        "a number" if unlimited else f"{low:g} to {high:g}", read, write, unit.behind.strip()
    )


def deviation(unit: Unit, most: float) -> Kind:
    """Return the kind of a standard deviation of a reading, in SI no larger than ``most``."""
    any_number = number(unit)
    limits = f"{units.NOISE[0] / unit.si:g} to {most / unit.si:g}"

    def read(cell: str) -> float:
        value: float = any_number.read(cell)
        if value <= 0:
            raise ValueError("not a standard deviation: give one above 0 or leave the field empty")
        if not units.NOISE[0] <= value <= most:
            raise ValueError(
                f"which no instrument has: give a standard deviation from {limits} or leave the "
                f"field empty"
            )
        return value

    return Kind(limits, read, any_number.write, any_number.unit)


def whole(low: int) -> Kind:
    """Return the kind of a whole number; ``3.0`` counts as one, as spreadsheets write it."""
    any_number = number()

    def read(cell: str) -> int:
        value = any_number.read(cell)
        if value != int(value) or value < low:
            raise ValueError(f"not a whole number from {low} on: correct it")
        return int(value)

    return Kind(f"a whole number from {low} on", read, str)


def words(meanings: Mapping[str, Any], remedy: str = "", nothing: Any = None) -> Kind:
    """Return the kind of a word that has a meaning; a meaning is written as its first word.

    Args:
        meanings: from word to meaning.
        remedy: of any other word, behind the word.
        nothing: the meaning of an empty cell.
    """
    shown: dict[Any, str] = {}
    for word, meaning in meanings.items():
        shown.setdefault(meaning, word)
    allowed = ", ".join(f"`{word}`" for meaning, word in shown.items() if meaning != nothing)
    shown[nothing] = ""

    def read(cell: str) -> Any:
        if cell not in meanings:
            raise ValueError(
                remedy or f"which is none of {', '.join(meanings)}: write one of these"
            )
        return meanings[cell]

    return Kind(allowed, read, shown.__getitem__)


def _label(cell: str) -> str:
    if "\n" in cell or "\r" in cell:
        raise ValueError("which has several lines: write it on one")
    if len(cell) > _LONGEST_LABEL:
        raise ValueError(f"of {len(cell)} characters: shorten it to {_LONGEST_LABEL}")
    return cell


LABEL = Kind(f"one line, up to {_LONGEST_LABEL} characters", _label)
"""A name for people."""
