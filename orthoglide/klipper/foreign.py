"""Files that owners give in place of a ``printer.cfg``, told by what stands in them."""

from __future__ import annotations

import re

_ELSE = (
    "not Klipper's printer.cfg: numbers are given for Klipper only; write a machine file with kind "
    '= "linear-delta" and touch the plate by a sheet, as docs/linear-deltas.md says'
)
_ARCHIVE = "is an archive: unpack it, and give the printer.cfg in it"
_KINDS = (
    (rb"\A(?:PK\x03\x04|\x1f\x8b|BZh|7z\xbc\xaf|\xfd7zXZ|Rar!)", _ARCHIVE),
    (rb"^=+ Config file =+|^Starting Klippy",
     "is Klipper's log, in which numbers may be of any time: give the printer.cfg that the "
     "firmware saved"),
    (rb"^[ \t]*(?://[ \t]*)?#define[ \t]+\w", f"is Marlin's configuration, {_ELSE}"),
    (rb"^;? ?config-override\.g\b|^[ \t]*(?:M584|M569 P|M558|M574|M950|M550)\b",
     f"is RepRapFirmware's config.g or config-override.g, {_ELSE}"),
    (rb"^(?:Recv: *)?(?:echo: *)?(?:M665|M666|M92|M851)\b",
     f"is what Marlin's M503 prints, {_ELSE}"),
)  # fmt: skip
_OWN = re.compile(rb"^\[(?:printer|stepper_\w+|include [^\]]+)\]", re.MULTILINE)
_LOG = 2  # of the first kinds: what has sections of Klipper's all the same


def foreign(content: bytes) -> str:
    """What a file is if it is no ``printer.cfg``, and what to do; empty where nobody knows."""
    kinds = _KINDS[:_LOG] if _OWN.search(content) else _KINDS
    return next((told for of, told in kinds if re.search(of, content, re.MULTILINE)), "")
