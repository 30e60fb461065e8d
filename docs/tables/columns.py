"""The columns of files of readings and the kinds of readings, from their schema.

``python docs/tables/columns.py`` prints the lists of ``docs/files.md``.
"""

from __future__ import annotations

from orthoglide.instruments import OBSERVATIONS, Observation
from orthoglide.observations import schema
from orthoglide.observations.schema import COLUMNS, COMMANDS, ORDER, Column

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
    """Return the kinds of readings that have a column; nothing if all have."""
    found = [kind for kind, one in OBSERVATIONS.items() if has(column, one)]
    tool = [kind for kind, one in OBSERVATIONS.items() if not one.on_leg]
    without = [kind for kind in OBSERVATIONS if kind not in found]
    if len(without) <= 1:
        return "".join(f"all but `{kind}`" for kind in without)
    return "all of the tool" if found == tool else ", ".join(f"`{kind}`" for kind in found)


def empty(column: Column) -> str:
    """Return what an empty cell or an absent column stands for."""
    if column in schema.READINGS.values() or column.required:
        return "" if column is ORDER or column in WAYS else "required"
    written = column.kind.write(column.empty_value)
    shown = f"{column.empty_value:g}" if isinstance(column.empty_value, float) else written
    return f"default `{shown}`" if written else ""


def sentences(column: Column) -> str:
    """Return the meaning of a column, with the words that it takes."""
    words = ", ".join(f"`{word}`" for word in column.kind.choices)
    return f"{column.meaning} One of {words}." if words else column.meaning


def column_list() -> str:
    """Return the list of the columns, without those of a second command."""
    shown = [column for column in COLUMNS if column not in COMMANDS.values()]
    remarks = ["; ".join(filter(None, (empty(c), kinds(c)))) for c in shown]
    return "\n".join(
        f"- {names(column)}{f' ({remark})' if remark else ''}: {sentences(column)}"
        for column, remark in zip(shown, remarks, strict=True)
    )


def kind_list() -> str:
    """Return the list of the kinds of readings, with what is fitted with every setup."""
    return "\n".join(
        f"- `{kind}`, {one.instrument_phrase}: {one.sheet_instruction}. Fitted: "
        f"{one.nuisance_summary}."
        for kind, one in OBSERVATIONS.items()
    )


def markdown() -> str:
    """Return the lists of the page."""
    kinds_head = "Kinds of readings, with what is fitted with every setup:"
    return f"{column_list()}\n\n{kinds_head}\n\n{kind_list()}\n"


def main() -> None:
    print(markdown(), end="")


if __name__ == "__main__":
    main()
