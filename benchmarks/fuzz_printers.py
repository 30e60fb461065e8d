"""Whether what was imported from a firmware's file is what the file says, read a second way."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from tests.rig import Array

_TURN = 200.0  # full steps
_SAME = 2e-6  # mm
_SAID = 6e-3  # mm: half of the last digit of a shift that is said, and a little


def misread(content: bytes, out: Path, said: str) -> str:
    """The first number of heights and distances that the campaign has differently; else empty.

    Args:
        content: of the firmware's file.
        out: folder with ``calibration.csv``, if heights or distances were found.
        said: by the import, on the terminal.
    """
    stored = _stored(content.decode("utf-8-sig", "replace"))
    path = out / "calibration.csv"
    rows = list(csv.DictReader(path.open(newline=""))) if path.exists() else []
    known = stored.get("delta_calibrate", {})
    said = re.sub(r"'[^']*' is left out", "", said)  # a line elsewhere, that names a key
    if not rows and "heights and distances are left out: " in said:
        return ""
    for kind, name, ends in (("plate", "height", ("",)), ("distance", "distance", ("1", "2"))):
        told = [float(row["reading_mm"]) for row in rows if row["kind"] == kind]
        # What could not be read is left out by a sentence that names it.
        named = _numbered(known, name)
        wanted = {
            k: float(v) for k, v in named.items() if not re.search(rf"\b{name}{k}(_|\b)", said)
        }
        # All heights may be shifted by as much as a sentence says.
        off = re.search(rf"the {name}s of \[delta_calibrate\] lie (\S+) mm off", said)
        by = float(off[1].replace("\N{MINUS SIGN}", "-")) if off else 0.0
        moved = np.subtract(told, [*wanted.values()]) if len(told) == len(wanted) else np.ones(1)
        most = _SAID if off else _SAME
        uneven = np.abs(np.diff(moved)).max(initial=0.0) > _SAME
        if uneven or np.abs(moved - by).max(initial=0.0) > most:
            return f"{name}s {wanted} became {told}"
        for end in ends:
            steps = np.array([_three(known[f"{name}{k}_pos{end}"]) for k in wanted])
            if len(steps) and (apart := _moved(rows, kind, end, steps, stored)) > _SAME:
                return f"positions of {name}s are {apart:.3g} mm off"
    return ""


def _moved(
    rows: list[dict[str, str]], kind: str, end: str, steps: Array, stored: dict[str, dict[str, str]]
) -> float:
    """Largest difference between the travel from the first position and that of the steps, mm."""
    far, second = 0.0, "2" if end == "2" else ""
    for k, tower in enumerate("abc"):
        # What a tower's section leaves out is the first one's.
        own = stored["stepper_a"] | stored[f"stepper_{tower}"]
        turn = float(own.get("full_steps_per_rotation", _TURN)) * float(own["microsteps"])
        one = float(own["rotation_distance"]) / turn
        travel = [float(r[f"travel_{tower}{second}_mm"]) for r in rows if r["kind"] == kind]
        moved = np.array(travel) - travel[0] + (steps[:, k] - steps[0, k]) * one
        far = max(far, float(np.abs(moved).max()))
    return far


def _numbered(section: dict[str, str], name: str) -> dict[int, str]:
    """Values of ``height0``, ``height1`` ... that have a position, by number."""
    numbers = sorted(
        int(m[1]) for key in section if (m := re.fullmatch(rf"{name}([0-9]{{1,4}})", key))
    )
    return {k: section[f"{name}{k}"] for k in numbers}


def _three(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]


def _stored(text: str) -> dict[str, dict[str, str]]:
    """Sections with their keys, the last of each counting, and an owner's before saved ones."""
    found: dict[str, dict[str, str]] = {}
    section = found.setdefault("", {})
    for line in sorted(text.splitlines(), key=lambda line: not line.startswith("#*#")):
        line = re.sub(r"^#\*# ?", "", line)
        if line[:1].isspace() or not (line := re.split(r"\s*[#;]", line)[0].strip()):
            continue
        if line.startswith("["):
            name = re.match(r"\[([^\]]+)\]", line)  # one that is none takes its keys with it
            section = found.setdefault(name[1].strip() if name else "", {})
        elif match := re.fullmatch(r"([^:=]+?)\s*[:=]\s*(.*)", line):
            section[match[1].lower()] = match[2]
    return found
