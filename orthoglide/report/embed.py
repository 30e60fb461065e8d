"""SVG files for inclusion in a page: with its font, its colours, and unique names."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET

from orthoglide.figures.style import PALETTE, Drawing

_SVG, _LINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_HREF = f"{{{_LINK}}}href"
_REFERENCE = re.compile(r"url\(#([^)]+)\)")


def inline_svg(drawing: Drawing) -> str:
    """Return a drawing as one inline ``<svg>``."""
    root = _parsed_svg(drawing)
    _, _, width, height = (float(v) for v in root.get("viewBox", "").split())
    body = [child for child in root if _tag(child) in ("g", "defs")]
    return _inline(body, (0.0, 0.0, width, height), drawing.title)


def inline_panels(drawing: Drawing) -> list[str]:
    """Return each panel of a drawing as an inline ``<svg>``, so that a page can arrange them.

    Marks that several panels share are defined in the first, to which the others refer.
    """
    root = _parsed_svg(drawing)
    figure = next(child for child in root if _tag(child) == "g")
    axes = [child for child in figure if (child.get("class") == "axes")]
    shared = [child for child in root if _tag(child) == "defs"]
    groups = [axes[k : k + drawing.axes] for k in range(0, len(axes), drawing.axes)]
    return [
        _inline([*(shared if k == 0 else []), *group], box, f"{drawing.title}, {k + 1}")
        for k, (group, box) in enumerate(zip(groups, drawing.panels, strict=True))
    ]


def _parsed_svg(drawing: Drawing) -> ET.Element:
    """Return the parsed file without what a page has itself; only ids that are used remain."""
    root = ET.fromstring(re.sub(r"<!DOCTYPE[^>]*>", "", drawing.svg))
    for child in list(root):
        if _tag(child) == "metadata" or child.find(f"{{{_SVG}}}style") is not None:
            root.remove(child)
    used = {link[1:] for e in root.iter() if (link := e.get(_HREF))}
    used |= {m for e in root.iter() for v in e.attrib.values() for m in _REFERENCE.findall(v)}
    for element in root.iter():
        _adapt(element, drawing.name, used)
    return root


def _adapt(element: ET.Element, prefix: str, used: set[str]) -> None:
    name = element.attrib.pop("id", None)
    if name in used:
        element.set("id", f"{prefix}-{name}")
    elif name and name.startswith("axes_"):
        element.set("class", "axes")
    link = element.attrib.pop(_HREF, None)
    if link:
        element.set("href", f"#{prefix}-{link[1:]}")
    for key, value in element.attrib.items():
        value = _REFERENCE.sub(rf"url(#{prefix}-\1)", value)
        for colour, code in PALETTE.items():
            value = value.replace(code, f"var(--fig-{colour})")
        if key == "style":  # the page's font
            value = re.sub(r"font-family: [^;]*; ?", "", value)
        element.set(key, value)


def _tag(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


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
    for element in body:
        svg.append(_without_namespace(element))
    return ET.tostring(svg, encoding="unicode")


def _without_namespace(element: ET.Element) -> ET.Element:
    """Return a copy without namespaces, which the elements of SVG do not need inside HTML."""
    copy = ET.Element(_tag(element), dict(element.attrib))
    copy.text = (element.text or "").strip() or None
    copy.extend(_without_namespace(child) for child in element)
    return copy
