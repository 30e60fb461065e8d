"""SVG files for inclusion in a page: with its font, its colours, and unique names."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET

from orthoglide.figures.style import PALETTE, Drawing

_REFERENCE = re.compile(r'(url\(#|href="#)([^)"]+)')
_UNNEEDED = re.compile(r'<!DOCTYPE[^>]*>| xmlns(:xlink)?="[^"]*"|font-family: [^;"]*; ?')


def inline_svg(drawing: Drawing) -> str:
    """Return a drawing as one inline ``<svg>``."""
    root = _parsed_svg(drawing)
    _, _, width, height = (float(v) for v in root.get("viewBox", "").split())
    body = [child for child in root if child.tag in ("g", "defs")]
    return _inline(body, (0.0, 0.0, width, height), drawing.title)


def inline_panels(drawing: Drawing) -> list[str]:
    """Return each panel of a drawing as an inline ``<svg>``, so that a page can arrange them.

    Marks that several panels share are defined in the first, to which the others refer.
    """
    root = _parsed_svg(drawing)
    figure = next(child for child in root if child.tag == "g")
    axes = [child for child in figure if (child.get("class") == "axes")]
    shared = [child for child in root if child.tag == "defs"]
    groups = [axes[k : k + drawing.axes] for k in range(0, len(axes), drawing.axes)]
    return [
        _inline([*(shared if k == 0 else []), *group], box, f"{drawing.title}, {k + 1}")
        for k, (group, box) in enumerate(zip(groups, drawing.panels, strict=True))
    ]


def _parsed_svg(drawing: Drawing) -> ET.Element:
    """Return the elements of a file as a page needs them: without namespaces, fonts and margins,
    with the page's colours, and with ids that are unique on the page. Only ids that are used
    remain; groups of axes have a class.
    """
    used = {name for _, name in _REFERENCE.findall(drawing.svg)}

    def named(match: re.Match[str]) -> str:
        if match[1] in used:
            return f' id="{drawing.name}-{match[1]}"'
        return ' class="axes"' if match[1].startswith("axes_") else ""

    def adapted(tag: re.Match[str]) -> str:
        text = _UNNEEDED.sub("", tag[0]).replace("xlink:href", "href")
        text = re.sub(r' id="([^"]*)"', named, _REFERENCE.sub(rf"\1{drawing.name}-\2", text))
        for colour, code in PALETTE.items():
            text = text.replace(code, f"var(--fig-{colour})")
        return text

    # Texts contain no angle brackets: these are escaped.
    root = ET.fromstring(re.sub(r">\s+<", "><", re.sub("<[^>]*>", adapted, drawing.svg)))
    for child in list(root):
        if child.tag == "metadata" or child.find("style") is not None:
            root.remove(child)
    return root


def _inline(body: list[ET.Element], box: tuple[float, float, float, float], title: str) -> str:
    x, y, width, height = box
    svg = ET.Element(
        "svg",
        {
            "viewBox": f"{x:g} {y:g} {width:g} {height:g}",
            "role": "img",
            "aria-label": title,
            "preserveAspectRatio": "xMidYMid meet",
        },
    )
    svg.extend(body)
    return ET.tostring(svg, encoding="unicode")
