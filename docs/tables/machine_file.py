"""The keys of the machine file, from its schema.

``python docs/tables/machine_file.py`` prints the table of ``docs/files.md``.
"""

from __future__ import annotations

from dataclasses import MISSING, fields
from decimal import Decimal
from typing import Any

from orthoglide.effects import CATALOGUE
from orthoglide.machine_file import schema
from orthoglide.machine_file.document import Key, Section
from orthoglide.units import Unit

HEAD = ("key", "default", "meaning")
NO_DEFAULTS = (schema.TOP, schema.GEOMETRY)  # a nominal machine has values that no file may omit
FAMILY_UNIT = Unit("the effect's", 1.0)


def default(section: Section, key: Key) -> str:
    """Return what is taken where a key is absent; nothing where its meaning says it."""
    if key.required:
        return "required"
    found = {field.name: field.default for field in fields(section.record_class)}.get(
        key.field_name, MISSING
    )
    if section in NO_DEFAULTS or found is MISSING or found in (None, ""):
        return ""
    return f"`{written(key.kind.write(found))}`"


def written(value: Any) -> str:
    """Return a value as a file has it."""
    if isinstance(value, list):
        return f"[{', '.join(map(written, value))}]"
    return f"{float(value):g}" if isinstance(value, Decimal) else str(value)


def row(*cells: str) -> str:
    """Return a line of the table."""
    return f"| {' | '.join(cells)} |".replace("|  |", "| |").replace("|  |", "| |")


def rows(section: Section, keys: tuple[Key, ...] = ()) -> list[str]:
    """Return a line for each key of a section, or for those given."""
    return [row(f"`{k.name}`", default(section, k), k.meaning) for k in keys or section.keys]


def layout_rows() -> list[str]:
    """Return the lines of ``[layout]``: keys of every kind, of one kind, and of a free leg."""
    delta, free = (schema.LAYOUTS[kind] for kind in ("linear-delta", "legs"))
    only = tuple(key for key in delta.keys if key not in free.keys)
    return [
        *rows(free),
        row('of `kind = "linear-delta"`', "", "Legs on three towers; these keys besides."),
        *rows(delta, only),
        row(
            f"**`[{schema.LEG.name}]`**", "", 'Three tables of `kind = "legs"`; vectors are lists.'
        ),
        *rows(schema.LEG),
    ]


def markdown() -> str:
    """Return the table of the page."""
    lines = [row(*HEAD), "|---|---|---|", *rows(schema.TOP)]
    known = (
        schema.GEOMETRY,
        schema.INSTRUMENT,
        schema.DRIVE,
        schema.CLASS,
        *schema.SECTIONS_BY_ATTRIBUTE.values(),
    )
    keys = {section.name: rows(section) for section in known}
    keys["layout"] = layout_rows()
    keys["tolerance"] = rows(schema.tolerances(CATALOGUE), (schema.SURFACE_SLOPE,))
    keys["parameters"] = rows(schema.parameter(FAMILY_UNIT))
    for table, meaning in schema.TABLES.items():
        lines += [row(f"**`[{table}]`**", "", meaning), *keys.get(table, ())]
    return "\n".join(lines) + "\n"


def main() -> None:
    print(markdown(), end="")


if __name__ == "__main__":
    main()
