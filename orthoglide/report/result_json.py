"""``result.json``: a result for programs."""

from __future__ import annotations

import json

from orthoglide.report.wording import headline
from orthoglide.result import Result


def result_text(result: Result) -> str:
    """The text of ``result.json``: the same bytes for the same result."""
    every = result.as_dict(headline(result))
    return json.dumps(every, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
