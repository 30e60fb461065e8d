"""Pages from templates: what they show is data, never markup."""

from __future__ import annotations

from typing import Any


def rendered(template: str, **data: Any) -> str:
    """A template in the folder ``templates`` with the data that it names; one that is missing is an
    error.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("orthoglide.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(**data)
