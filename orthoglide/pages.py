"""Pages: from templates, which show data and never markup, and small ones without."""

from __future__ import annotations

from html import escape
from typing import Any


def small_page(title: str, style: str, body: str) -> str:
    """A self-contained HTML page of a heading and what is below it, which is markup."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{style}</style></head><body>"
        f"<h1>{escape(title)}</h1>{body}</body></html>\n"
    )


def rendered(package: str, template: str, **data: Any) -> str:
    """A template of a package with what it shows.

    Args:
        package: that has the folder ``templates``.
        template: its path in there.
        data: by the names that the template uses; one that is missing is an error.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(**data)
