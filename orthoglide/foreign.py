"""Firmware that wrote a file, by the contents of the file, and what to do with it."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Sequence
from pathlib import Path
from statistics import fmean

from orthoglide.errors import FileError
from orthoglide.text import MACHINE_OPTION, listed, printable_path

_PLATES_ADVICE = (
    ", which is a list of plate points: read it with orthoglide import plates {}"
    f"{MACHINE_OPTION} --out DIR"
)
_NUMBER = r"([-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+))"  # also with a decimal comma
_OTHER_FILES = {  # of no machine: text that only such files contain, and what to do with them
    "archive": (
        r"\A(?:PK\x03\x04|\x1f|BZh|7z\xbc\xaf|\xfd7zXZ|Rar!)",
        "is an archive: unpack it, and give the file in it",
    ),
    "log": (
        r"^=+ Config file =+|^Starting Klippy",
        "is Klipper's log, in which numbers may be of any time: give the printer.cfg that the "
        "firmware saved",
    ),
    "klipper": (
        r"^\[(?:printer|stepper_\w+|include [^\]]+)\]",
        "is Klipper's printer.cfg: read it with orthoglide import klipper {} --out DIR",
    ),
    "height map": (
        r"(?i)^RepRapFirmware height map file", f"is RepRapFirmware's height map{_PLATES_ADVICE}",
    ),
    "bed lines": (
        r"(?i)^.*\bbed +x *:.*\by *:.*\bz *:", f"has Marlin's lines of touches{_PLATES_ADVICE}",
    ),
    "probe lines": (
        r"\bprobe:? at \S+ (?:is|bed will contact at) z=",
        f"has Klipper's lines of touches{_PLATES_ADVICE}",
    ),
    "grid": (
        r"(?i)\bbilinear leveling grid\b|\bbed topography report\b"
        r"|\bmesh leveling probed z positions\b|^\s*\{\s*\"mesh\"|^\s*\[\s*\[[-\d]",
        "is a grid of heights without the places that were touched: probe the plate again and save "
        "the lines that name x, y and z (Marlin prints 'Bed X: Y: Z:' with G29 V4, Klipper 'probe "
        "at X,Y is z=Z'), or write a table of x, y and z",
    ),
    "calibration log": (
        r"\bG33 Auto Calibrat|Calibrated \d+ factors\b|\bBed probe heights:",
        "is what a calibration prints (Marlin's G33, RepRapFirmware's G32), numbers that it found "
        "without places of touches: probe the plate (Marlin G29 V4, RepRapFirmware G29 S0), and "
        "read the lines 'Bed X: Y: Z:' or heightmap.csv by orthoglide import plates",
    ),
}  # fmt: skip
_M665_WORD = r"^[^;\n]*\bM665\b[^;\n]*?\b{} *([-+]?[\d.,][\d.,:]*)"
_M665 = tuple(map(_M665_WORD.format, "LRXYZ"))
_TOWER_ANGLES = (210.0, 330.0, 90.0)  # degrees at which towers stand without trims
_BED_LINES = "probe the plate (G29), save its lines 'Bed X: Y: Z:' and read them"
_FIRMWARE_CONFIGS = {  # of a machine: text that only such files contain, how the firmware touches
    # the plate, and patterns of the arms' length, of the radius less the platform's, and of the
    # angle of each tower or its trim
    "Smoothieware's config": (
        r"^[ \t]*(?:arm_solution|(?:alpha|beta|gamma)_[\w.]+|zprobe\.\w+|leveling-strategy\.\S+)"
        r"[ \t]+\S|^;Optional arm solution specific",
        "probe a grid (G29), save its touches as lines x, y, z and read them",
        rf"^[ \t]*(?:arm_length[ \t]+|M665 L){_NUMBER}",
        rf"^[ \t]*(?:arm_radius[ \t]+|M665 L[\d.,]+ R){_NUMBER}",
        *(rf"^[ \t]*(?:delta_tower{k}_angle[ \t]+|M665 L.* {key}){_NUMBER}"
          for k, key in zip("123", "DEF", strict=True)),
    ),
    "Marlin's configuration": (
        r"^[ \t]*(?://[ \t]*)?#define[ \t]+\w", _BED_LINES,
        rf"^[ \t]*#define[ \t]+DELTA_DIAGONAL_ROD[ \t]+{_NUMBER}",
        rf"^[ \t]*#define[ \t]+DELTA_(?:CONFIGURABLE_)?RADIUS[ \t]+{_NUMBER}",
        *(rf"^[ \t]*#define[ \t]+DELTA_TOWER_ANGLE_TRIM[ \t]*\{{(?:[^,\n]*,){{{k}}} *{_NUMBER}"
          for k in range(3)),
    ),
    "RepRapFirmware's config.g or config-override.g": (
        r"^[ \t]*;.*\bconfig(?:-override)?\.g\b|^[ \t]*(?:M584|M569 P|M558|M574|M950|M550|M563)\b"
        r"|^[ \t]*M665\b(?![^;\n]*\bS *\d)[^;\n]*\b(?:L *[\d.]+:|B *\d)"
        r"|^[ \t]*M666\b[^;\n]*\b[AB] *-?[\d.]",
        "probe the plate (G29 S0) and read heightmap.csv", *_M665,
    ),
    "Repetier's EEPROM": (
        r"^EPR:3 881 ", "probe the plate, save its touches as lines x, y, z and read them",
        *(rf"^EPR:3 {key} {_NUMBER}" for key in (881, 885, 901, 905, 909)),
    ),
    "what Marlin's M503 prints": (
        r"^(?:Recv: *)?(?:echo: *)?[ \t]*(?:M665|M666|M92|M851)\b", _BED_LINES, *_M665,
    ),
}  # fmt: skip


def refuse_foreign(path: Path, content: bytes, accepted: Collection[str]) -> None:
    """Refuse a file that another firmware wrote, or that another command reads, by its first bytes;
    kinds that are accepted pass, as unknown ones do.

    Raises:
        FileError: states what the file is and what to do instead.
    """
    body = content.removeprefix(b"\xef\xbb\xbf")
    text = body.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
    file = printable_path(path)
    for kind, (pattern, message) in _OTHER_FILES.items():
        if re.search(pattern, text, re.MULTILINE):
            if kind in accepted:
                return
            raise FileError(message.format(shlex.quote(file)), file=file)
    for name, (pattern, touch_advice, *patterns) in _FIRMWARE_CONFIGS.items():
        if re.search(pattern, text, re.MULTILINE):
            raise FileError(
                f'is {name}, which is not read: write a machine file of kind "linear-delta"'
                f"{_sizes_clause(patterns, text)}, as docs/linear-deltas.md says; then "
                f"{touch_advice} by orthoglide import plates",
                file=file,
            )


def _sizes_clause(patterns: Sequence[str], text: str) -> str:
    """Return the sizes that settings of a firmware state, as a machine file has them."""
    sizes, angles = list[str](), list[float]()
    for key, pattern in zip(("L", "radius_mm less r_mm"), patterns, strict=False):
        if values := _first_numbers(pattern, text):  # several: one a tower
            sizes.append(f"{key} = {fmean(values):.7g}")
    for nominal, pattern in zip(_TOWER_ANGLES, patterns[2:], strict=True):
        (value, *_) = _first_numbers(pattern, text) or [0.0]
        angles.append(value + nominal * (abs(value) < nominal / 2))  # Repetier has no trims
    if tuple(angles) != _TOWER_ANGLES:
        sizes.append(f"angles_deg = [{', '.join(f'{angle:.7g}' for angle in angles)}]")
    return f" with {listed(sizes)}" if sizes else ""


def _first_numbers(pattern: str, text: str) -> list[float]:
    """Return the numbers in what a pattern finds first, with decimal points or commas."""
    match = re.search(pattern, text, re.MULTILINE | re.IGNORECASE)
    return [float(v.replace(",", ".")) for v in re.findall(_NUMBER, match[1])] if match else []
