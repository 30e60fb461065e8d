"""The columns of files of readings and the kinds of readings, from their schema.

``python docs/tables/columns.py`` prints the tables of ``docs/files.md``.
"""

from __future__ import annotations

from orthoglide.instruments import OBSERVATIONS, Observation
from orthoglide.observations import schema
from orthoglide.observations.schema import COLUMNS, COMMANDS, ORDER, Column

COLUMN_HEAD = "| column | kinds | if empty | meaning |\n|---|---|---|---|"
KIND_HEAD = "| kind | taken by | reading | fitted with every setup |\n|---|---|---|---|"
WAYS = (schema.TRAVEL, schema.PLACE)  # to state commands instead of joint coordinates


def names(column: Column) -> str:
    """Return the names of a column on an Orthoglide."""
    return ", ".join(f"`{name}`" for name in column.names())


def has(column: Column, observation: Observation) -> bool:
    """Return whether readings of a kind have a column, by the kind's own list if it is on one."""
    name = column.names()[0]
    listed = any(name in one.setup_columns for one in OBSERVATIONS.values())
    if column.per_setup and listed:
        return name in observation.setup_columns
    return column.applies_to(observation)


def kinds(column: Column) -> str:
    """Return the kinds of readings that have a column."""
    found = [kind for kind, one in OBSERVATIONS.items() if has(column, one)]
    tool = [kind for kind, one in OBSERVATIONS.items() if not one.on_leg]
    without = [kind for kind in OBSERVATIONS if kind not in found]
    if len(without) <= 1:
        return " but ".join(["all", *(f"`{kind}`" for kind in without)])
    return "all of the tool" if found == tool else ", ".join(f"`{kind}`" for kind in found)


def empty(column: Column) -> str:
    """Return what an empty cell or an absent column stands for."""
    if column in schema.READINGS.values() or column.required:
        return "" if column is ORDER or column in WAYS else "required"
    written = column.kind.write(column.empty_value)
    shown = f"{column.empty_value:g}" if isinstance(column.empty_value, float) else written
    return f"`{shown}`" if written else ""


def sentences(column: Column) -> str:
    """Return the meaning of a column, with the words that it takes."""
    words = ", ".join(f"`{word}`" for word in column.kind.choices)
    return f"{column.meaning} One of {words}." if words else column.meaning


def column_table() -> str:
    """Return the table of the columns, without those of a second command."""
    lines = [
        f"| {names(c)} | {kinds(c)} | {empty(c)} | {sentences(c)} |"
        for c in COLUMNS
        if c not in COMMANDS.values()
    ]
    return "\n".join([COLUMN_HEAD, *lines]).replace("|  |", "| |").replace("|  |", "| |")


def kind_table() -> str:
    """Return the table of the kinds of readings."""
    lines = [
        f"| `{kind}` | {one.instrument_phrase} | {one.sheet_instruction} | {one.nuisance_summary} |"
        for kind, one in OBSERVATIONS.items()
    ]
    return "\n".join([KIND_HEAD, *lines]).replace("|  |", "| |")


def markdown() -> str:
    """Return the tables of the page."""
    return f"{column_table()}\n\n{kind_table()}\n"


def main() -> None:
    print(markdown(), end="")


if __name__ == "__main__":
    main()
