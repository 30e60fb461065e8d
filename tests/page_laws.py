"""Laws of what a reader sees first, whatever was found: of the page before anything is unfolded."""

from __future__ import annotations

import html as escapes
import re
from collections.abc import Iterator

from orthoglide.effects import CATALOGUE, catalogue_of
from orthoglide.layout import LinearDelta

MOST_WORDS = 30
"""Of one sentence of the claim and of what speaks for it."""

_NUMBER = re.compile(r"[+−-]?\d+\.\d+")
_EFFECTS = {e.name for c in (CATALOGUE, catalogue_of(LinearDelta.names)) for e in c.effects}
_CODE = re.compile(rf"\b({'|'.join(_EFFECTS)})\.\w|\b\w+/(travel|approach|time|command|reversal)")


def unfolded(page: str) -> str:
    """The page as HTML without what a reader must unfold, without styles and drawings."""
    for tag in ("style", "script", "head", "svg"):
        page = re.sub(rf"<{tag}\b.*?</{tag}>", "", page, flags=re.DOTALL)
    inner = re.compile(r"<details[^>]*>(?:(?!<details).)*?</details>", re.DOTALL)
    while (shorter := inner.sub("", page)) != page:
        page = shorter
    return page


def plain(markup: str) -> str:
    """Text of HTML, on one line."""
    return " ".join(escapes.unescape(re.sub(r"<[^>]+>", " ", markup)).split())


def sentences(text: str) -> list[str]:
    """Sentences of a text; a full stop within a number or a name ends none."""
    return re.split(r"(?<=[.?]) (?=[A-Z\d])", text)


def too_long(text: str) -> list[str]:
    """Sentences that nobody reads to their end."""
    return [one for one in sentences(text) if len(one.split()) > MOST_WORDS]


def broken(page: str, dials: bool) -> Iterator[str]:
    """What a page breaks of these laws; ``dials``: whether dials were read on its legs."""
    seen = unfolded(page)
    text = plain(seen)
    for code in _CODE.finditer(text):
        yield f"an internal name: ...{text[max(code.start() - 40, 0) : code.end() + 10]}..."
    for row in re.findall(r"<tr>(.*?)</tr>", seen, re.DOTALL):
        cells = [plain(cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL)]
        values = [float(c.replace("−", "-")) for c in cells if _NUMBER.fullmatch(c)]
        if values and not any(values):
            yield f"a row of zeros: {cells}"
    for tile in re.findall(r'<div class="tile">(.*?)</div>', seen, re.DOTALL):
        found = re.search(r"([\d.]+) mm ± ([\d.]+) in a workpiece", plain(tile))
        if found and len({len(number.partition(".")[2]) for number in found.groups()}) > 1:
            yield f"digits that are not those of sigma: {plain(tile)}"
    # A test that confirms a cause may take any tool.
    if not dials and (lacked := re.search(r".{40}(?<!et a )\bdials?\b.{20}", text)):
        yield f"an instrument that nobody read: {lacked[0]}"
