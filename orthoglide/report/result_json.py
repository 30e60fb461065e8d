"""``result.json``: a result for programs."""

from __future__ import annotations

import json
from typing import Any

from orthoglide.report.words import headline
from orthoglide.result import Result


def result_text(result: Result) -> str:
    """Return the text of ``result.json``: the same bytes for the same result."""
    return f"{_text(result.as_dict(headline(result)))}\n"


def _text(value: Any, margin: str = "") -> str:
    """Return JSON with a line for each key and element.

    A list of numbers or words is one line, as is an object of them that is an element of a list,
    such as a row of readings; the encoder of the standard library is slow where it indents.
    """
    inner = f"{margin} "
    if isinstance(value, dict) and value:
        each = (f"{inner}{json.dumps(key)}: {_text(one, inner)}" for key, one in value.items())
        return "{\n" + ",\n".join(each) + f"\n{margin}}}"
    if _is_flat(value):
        return _line(value)
    each = (inner + (_line(one) if _is_flat(one) else _text(one, inner)) for one in value)
    return "[\n" + ",\n".join(each) + f"\n{margin}]"


def _line(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _is_flat(value: Any) -> bool:
    """Whether a value contains no list or object with anything in it."""
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return not any(isinstance(part, dict | list) and part for part in parts)
