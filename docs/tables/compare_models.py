"""When the simplified model is good enough.

Every effect of the catalogue at its tolerance, on the general mechanism; then the simplified
model's six parameters fitted to it. ``python docs/tables/compare_models.py`` prints what is
left, one line an effect, at its worst parameter; with ``--markdown`` the tables of
``docs/simplified-model.md``.
"""

from __future__ import annotations

import sys

from orthoglide.comparison import Row, compare_effects, worst_by_effect
from orthoglide.comparison.comparing import EQUAL_WITHIN
from orthoglide.comparison.tables import LIMITS, markdown_table

COLUMNS = (
    "effect", "size", "six fitted: mean, max", "platform turns", "six fitted: rms, max",
    "calibrated TCP: max", "up to",
)  # fmt: skip
LEGEND = (
    "Columns: the TCP's error and the readings' (rms, max) once the six parameters are fitted to "
    "each; the TCP's error of an identification from the readings, with priors and after the best "
    "translation; the size up to which the reduction will do. Lengths in µm, turns in µrad, over "
    "the largest cube within the strokes."
)


def effects() -> tuple[Row, ...]:
    return worst_by_effect(compare_effects())


def names(rows: tuple[Row, ...]) -> str:
    return ", ".join(f"`{row.effect}`" for row in rows) or "none"


def summary(rows: tuple[Row, ...]) -> str:
    seen = [r for r in rows if max(r.nominal.max, r.reading_change) > EQUAL_WITHIN]
    exact = tuple(r for r in seen if max(r.fitted.max, r.reading_max) <= EQUAL_WITHIN)
    enough = tuple(r for r in seen if r.good_enough and r not in exact)
    not_enough = tuple(r for r in seen if not r.good_enough)
    unseen = tuple(r for r in rows if r not in seen)
    return (
        f"- Represented exactly: {names(exact)}.\n"
        f"- Not represented, but small enough at their tolerance: {names(enough)}.\n"
        f"- Beyond the reduction at their tolerance: {names(not_enough)}.\n"
        f"- Without effect on a machine that is else perfect: {names(unseen)}.\n"
    )


def markdown() -> str:
    rows = effects()
    return f"{LIMITS}\n\n{summary(rows)}\n{LEGEND}\n\n{markdown_table(rows, COLUMNS)}"


def main() -> None:
    if "--markdown" in sys.argv[1:]:
        print(markdown(), end="")
        return
    print(LIMITS)
    for row in effects():
        print(row)


if __name__ == "__main__":
    main()
