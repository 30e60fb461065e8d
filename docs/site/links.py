"""What is wrong with the pages of a site: links that lead nowhere, and requests to elsewhere."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADED = {"img": "src", "script": "src", "iframe": "src", "source": "src", "link": "href"}
_STYLE = re.compile(r"(?:url\(|@import)\s*['\"]?\s*(?:https?:)?//")


class Page(HTMLParser):
    """Anchors of a page, where its links lead, and what it loads by itself."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag names or leads to."""
        given = {name: value for name, value in attrs if value is not None}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if (name := _LOADED.get(tag)) in given and given.get("rel") != "canonical":
            self.loaded.append(given[str(name)])


def faults(site: Path) -> list[str]:
    """Everything that is wrong, in sentences."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    found = []
    for path, page in pages.items():
        name = path.relative_to(site)
        found += [f"{name} loads {at}" for at in page.loaded if urlsplit(at).netloc]
        for link in [*page.links, *page.loaded]:
            to = urlsplit(link)
            if to.scheme or to.netloc:
                continue
            target = (path.parent / unquote(to.path)).resolve() if to.path else path
            if not target.is_file():
                found.append(f"{name} leads to {link}, which is not there")
            elif (
                to.fragment
                and target in pages
                and (unquote(to.fragment) not in pages[target].anchors)
            ):
                found.append(f"{name} leads to {link}, and there is no such place")
    for style in site.rglob("*.css"):
        if _STYLE.search(style.read_text(encoding="utf-8")):
            found.append(f"{style.relative_to(site)} loads something from elsewhere")
    return found
