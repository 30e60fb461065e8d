"""When the simplified model is good enough.

Every effect of the catalogue at its tolerance, on the general mechanism; then the simplified
model's six parameters fitted to it. ``python docs/tables/compare_models.py`` prints what is
left, one line an effect, at its worst parameter; with ``--markdown`` the tables of
``docs/simplified-model.md``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable

from orthoglide.comparison import Row, compare_effects, worst_by_effect
from orthoglide.comparison.comparing import EQUAL_WITHIN, LIMITS, markdown_table

COLUMNS = (
    "effect",
    "size",
    "TCP differs, max, µm",
    "platform turns",
    "readings differ, rms, µm",
    "up to",
)
LEGEND = (
    "Differences once the six parameters are fitted, turns in µrad; the size *up to* which the "
    "simplified model will do."
)


def effects() -> tuple[Row, ...]:
    return worst_by_effect(compare_effects())


def names(rows: Iterable[Row]) -> str:
    return ", ".join(f"`{row.effect}`" for row in rows) or "none"


def markdown() -> str:
    rows = effects()
    seen = [r for r in rows if max(r.nominal.max, r.reading_change) > EQUAL_WITHIN]
    exact = [r for r in seen if max(r.fitted.max, r.reading_max) <= EQUAL_WITHIN]
    unseen = [r for r in rows if r not in seen]
    summary = (
        f"- Represented exactly: {names(exact)}.\n"
        f"- Without effect on an otherwise perfect machine: {names(unseen)}.\n"
    )
    shown = tuple(r for r in seen if r not in exact)
    return f"{LIMITS}\n\n{summary}\n{LEGEND}\n\n{markdown_table(shown, COLUMNS)}"


def main() -> None:
    if "--markdown" in sys.argv[1:]:
        print(markdown(), end="")
        return
    print(LIMITS)
    for row in effects():
        print(row)


if __name__ == "__main__":
    main()
