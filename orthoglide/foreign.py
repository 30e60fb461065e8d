"""Firmware that wrote a file, by the contents of the file, and what to do with it."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection
from pathlib import Path
from statistics import fmean

from orthoglide.errors import FileError
from orthoglide.text import MACHINE_OPTION, printable_path

_PLATES_ADVICE = (
    ", which is a list of plate points: read it with orthoglide import plates {}"
    f"{MACHINE_OPTION} --out DIR"
)
_NUMBER = r"(\d+(?:[.,]\d*)?|[.,]\d+)"  # also with a decimal comma
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
        r"\bG33 Auto Calibrat",
        "is what Marlin's G33 prints, numbers that it found and no touches: probe the plate (G29 "
        "V4), save its lines 'Bed X: Y: Z:' and read them by orthoglide import plates",
    ),
}  # fmt: skip
_M665 = (r"^.*\bM665\b[^;\n]*?\bL *([\d.,:]+)", r"^.*\bM665\b[^;\n]*?\bR *([\d.,:]+)")
_BED_LINES = "probe the plate (G29), save its lines 'Bed X: Y: Z:' and read them"
_FIRMWARE_CONFIGS = {  # of a machine: text that only such files contain, how the firmware touches
    # the plate, and patterns of the arms' length and of the radius less the platform's
    "Smoothieware's config": (
        r"^[ \t]*(?:arm_solution|(?:alpha|beta|gamma)_[\w.]+|zprobe\.\w+|leveling-strategy\.\S+)"
        r"[ \t]+\S|^;Optional arm solution specific",
        "probe a grid (G29), save its touches as lines x, y, z and read them",
        rf"^[ \t]*(?:arm_length[ \t]+|M665 L){_NUMBER}",
        rf"^[ \t]*(?:arm_radius[ \t]+|M665 L[\d.,]+ R){_NUMBER}",
    ),
    "Marlin's configuration": (
        r"^[ \t]*(?://[ \t]*)?#define[ \t]+\w", _BED_LINES,
        rf"^[ \t]*#define[ \t]+DELTA_DIAGONAL_ROD[ \t]+{_NUMBER}",
        rf"^[ \t]*#define[ \t]+DELTA_(?:CONFIGURABLE_)?RADIUS[ \t]+{_NUMBER}",
    ),
    "RepRapFirmware's config.g or config-override.g": (
        r"^[ \t]*;.*\bconfig(?:-override)?\.g\b|^[ \t]*(?:M584|M569 P|M558|M574|M950|M550|M563)\b"
        r"|^[ \t]*M665\b(?![^;\n]*\bS *\d)[^;\n]*\b(?:L *[\d.]+:|B *\d)"
        r"|^[ \t]*M666\b[^;\n]*\b[AB] *-?[\d.]",
        "probe the plate (G29 S0) and read heightmap.csv", *_M665,
    ),
    "Repetier's EEPROM": (
        r"^EPR:3 881 ", "probe the plate, save its touches as lines x, y, z and read them",
        rf"^EPR:3 881 {_NUMBER}", rf"^EPR:3 885 {_NUMBER}",
    ),
    "what Marlin's M503 prints": (
        r"^(?:Recv: *)?(?:echo: *)?[ \t]*(?:M665|M666|M92|M851)\b", _BED_LINES, *_M665,
    ),
}  # fmt: skip


def refuse_foreign(path: Path, content: bytes, accepted: Collection[str]) -> None:
    """Refuse a file that another firmware wrote, or that another command reads.

    Args:
        path: path of the file.
        content: first bytes of the file.
        accepted: kinds that are accepted, as are unknown ones.

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
    for name, (pattern, touch_advice, arm, radius) in _FIRMWARE_CONFIGS.items():
        if re.search(pattern, text, re.MULTILINE):
            sizes = list[str]()
            for key, size_pattern in (("L", arm), ("radius_mm less r_mm", radius)):
                match = re.search(size_pattern, text, re.MULTILINE | re.IGNORECASE)
                if match and (values := re.findall(_NUMBER, match[1])):  # several: one a tower
                    sizes.append(f"{key} = {fmean(float(v.replace(',', '.')) for v in values):.7g}")
            sizes_text = f" with {' and '.join(sizes)}" if sizes else ""
            raise FileError(
                f'is {name}, which is not read: write a machine file of kind "linear-delta"'
                f"{sizes_text}, as docs/linear-deltas.md says; then {touch_advice} by orthoglide "
                f"import plates",
                file=file,
            )
