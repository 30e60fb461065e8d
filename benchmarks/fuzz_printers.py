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
_SAID_SCALE = 6e-5  # half of the last digit of a longer step that is said, and a little


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
    left_out = "\n".join(re.findall(r"left out: (.*)", said))
    if not rows and left_out.startswith("heights and distances: "):
        return ""
    for kind, name, ends in (("plate", "height", ("",)), ("distance", "distance", ("1", "2"))):
        told = [float(row["reading_mm"]) for row in rows if row["kind"] == kind]
        # What could not be read is left out by a sentence that names it.
        named = _numbered(known, name)
        wanted = {
            k: float(v) for k, v in named.items() if not re.search(rf"\b{name}{k}(_|\b)", left_out)
        }
        if not told and re.search(rf"^all [0-9]+ {name}s of ", left_out, re.MULTILINE):
            continue
        # All heights may be shifted by as much as a sentence says.
        off = re.search(rf"the {name}s of \[delta_calibrate\] are (?:all )?(\S+) mm away", said)
        by = float(off[1].replace("\N{MINUS SIGN}", "-")) if off else 0.0
        moved = np.subtract(told, [*wanted.values()]) if len(told) == len(wanted) else np.ones(1)
        most = _SAID if off else _SAME
        uneven = np.abs(np.diff(moved)).max(initial=0.0) > _SAME
        if uneven or np.abs(moved - by).max(initial=0.0) > most:
            return f"{name}s {wanted} became {told}"
        for end in ends:
            steps = np.array([_three(known[f"{name}{k}_pos{end}"]) for k in wanted])
            if len(steps) == 0:
                continue
            scales = _said_scales(name, said)
            apart, travel = _moved(rows, kind, end, steps * scales, stored)
            if apart > _SAME + _SAID_SCALE * travel * (scales != 1.0).any():
                return f"positions of {name}s are {apart:.3g} mm off"
    return ""


def _moved(
    rows: list[dict[str, str]], kind: str, end: str, steps: Array, stored: dict[str, dict[str, str]]
) -> tuple[float, float]:
    """Largest difference between the travel from the first position and that of the steps, and the
    largest travel from there, mm.
    """
    far, most, second = 0.0, 0.0, "2" if end == "2" else ""
    for k, tower in enumerate("abc"):
        # What a tower's section leaves out is the first one's.
        own = stored["stepper_a"] | stored[f"stepper_{tower}"]
        turn = float(own.get("full_steps_per_rotation", _TURN)) * float(own["microsteps"])
        one = float(own["rotation_distance"]) / turn
        travel = [float(r[f"travel_{tower}{second}_mm"]) for r in rows if r["kind"] == kind]
        moved = np.array(travel) - travel[0] + (steps[:, k] - steps[0, k]) * one
        far = max(far, float(np.abs(moved).max()))
        most = max(most, float(np.ptp(travel)))
    return far, most


def _said_scales(name: str, said: str) -> Array:
    """Ratio of each tower's steps at the readings to those of now, where a sentence says so."""
    scales = np.ones(3)
    changed = re.search(
        rf"the (?:\w+ and )?{name}s (?:and \w+ )?of \[delta_calibrate\] fit the stored numbers "
        r"with steps(?: of tower (\w))? that are (\S+) % (longer|shorter) than now",
        said,
    )
    if changed:
        towers = ["abc".index(changed[1])] if changed[1] else [0, 1, 2]
        scales[towers] += float(changed[2]) * (0.01 if changed[3] == "longer" else -0.01)
    stored = re.search(
        rf"of {name}s in \[delta_calibrate\] were stored with (\S+) times the microsteps of now, "
        r"(?:and|on tower (\w))",
        said,
    )
    if stored:
        scales[["abc".index(stored[2])] if stored[2] else [0, 1, 2]] /= float(stored[1])
    return scales


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
