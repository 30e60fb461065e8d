"""When the simplified model is good enough.

Every effect of the catalogue at its tolerance, on the general mechanism; then the simplified
model's six parameters fitted to it. ``python docs/tables/compare_models.py`` prints what is
left, one line an effect, at its worst parameter; with ``--markdown`` the tables of
``docs/simplified-model.md``.
"""

from __future__ import annotations

import sys

from orthoglide import Machine
from orthoglide.comparison import Row, compare_effects, compare_machine, worst_by_effect
from orthoglide.comparison.rows import SAME
from orthoglide.comparison.tables import LEGEND, LIMITS, markdown_table

# A machine with one error of every kind that a careful builder leaves, at half its tolerance.
TYPICAL = (
    "joint_offset.x", "leg_length.y", "axis_offset.x.y", "axis_tilt.z.x", "bar_mismatch.y",
    "rail_bow.x.z", "backlash.z",
)  # fmt: skip


def typical_machine() -> Machine:
    nominal = Machine.nominal()
    return nominal.with_parameters({name: nominal.tolerance(name) / 2 for name in TYPICAL})


def effects() -> tuple[Row, ...]:
    return worst_by_effect(compare_effects())


def machine() -> tuple[Row, ...]:
    return compare_machine(typical_machine())


def names(rows: tuple[Row, ...]) -> str:
    return ", ".join(f"`{row.effect}`" for row in rows) or "none"


def summary(rows: tuple[Row, ...]) -> str:
    seen = [r for r in rows if max(r.nominal.max, r.reading_change) > SAME]
    exact = tuple(r for r in seen if max(r.fitted.max, r.reading_max) <= SAME)
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
    return (
        f"{LIMITS}\n\n{summary(rows)}\n{LEGEND}\n\n"
        f"### Every effect at its tolerance, its worst parameter\n\n{markdown_table(rows)}\n"
        "### A machine with seven errors at half their tolerance\n\n"
        f"{markdown_table(machine())}"
    )


def main() -> None:
    if "--markdown" in sys.argv[1:]:
        print(markdown(), end="")
        return
    print(LIMITS)
    for row in (*effects(), *machine()[:1]):
        print(row)


if __name__ == "__main__":
    main()
