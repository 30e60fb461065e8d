"""Pages from templates: what they show is data, never markup, and is written out there."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from orthoglide.numerals import compact, plain, probability, signed, with_sigma
from orthoglide.report.words import gain_words
from orthoglide.text import listed, sentence

if TYPE_CHECKING:
    from jinja2 import Environment

_WORDS = (sentence, listed, gain_words, compact, plain, signed, probability, with_sigma)


def rendered(template: str, **data: Any) -> str:
    """A template in the folder ``templates`` with the data that it names; one that is missing is an
    error. Filters there are the functions that put numbers and clauses into words, and ``fixed``.
    """
    return _environment().get_template(template).render(**data)


@cache
def _environment() -> Environment:
    """Where templates are found, each compiled once."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("orthoglide.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update({word.__name__: word for word in _WORDS}, fixed="{:.{}f}".format)
    return environment
