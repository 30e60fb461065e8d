"""Pages from templates: what they show is data, never markup."""

from __future__ import annotations

from typing import Any


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
