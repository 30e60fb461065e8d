"""The keys of the machine file, from its schema.

``python docs/tables/machine_file.py`` prints the list of ``docs/files.md``.
"""

from __future__ import annotations

from dataclasses import MISSING, fields
from decimal import Decimal
from typing import Any

from orthoglide.effects import CATALOGUE
from orthoglide.machine_file import schema
from orthoglide.machine_file.document import Key, Section
from orthoglide.units import Unit

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
    return f"default `{written(key.kind.write(found))}`"


def written(value: Any) -> str:
    """Return a value as a file has it."""
    if isinstance(value, list):
        return f"[{', '.join(map(written, value))}]"
    return f"{float(value):g}" if isinstance(value, Decimal) else str(value)


def items(section: Section, keys: tuple[Key, ...] = ()) -> list[str]:
    """Return an item for each key of a section, or for those given."""
    remarks = {key: default(section, key) for key in keys or section.keys}
    return [
        f"- `{key.name}`{f' ({remark})' if remark else ''}: {key.meaning}"
        for key, remark in remarks.items()
    ]


def layout_items() -> list[str]:
    """Return the items of ``[layout]``: keys of every kind, of one kind, and of a free leg."""
    delta, free = (schema.LAYOUTS[kind] for kind in ("linear-delta", "legs"))
    only = tuple(key for key in delta.keys if key not in free.keys)
    return [
        *items(free),
        '\nMore of `kind = "linear-delta"`:\n',
        *items(delta, only),
        f'\n**`[{schema.LEG.name}]`**: three tables of `kind = "legs"`; vectors are lists.\n',
        *items(schema.LEG),
    ]


def markdown() -> str:
    """Return the list of the page."""
    lines = items(schema.TOP)
    known = (
        schema.GEOMETRY,
        schema.INSTRUMENT,
        schema.DRIVE,
        schema.CLASS,
        *schema.SECTIONS_BY_ATTRIBUTE.values(),
    )
    keys = {section.name: items(section) for section in known}
    keys["layout"] = layout_items()
    keys["tolerance"] = items(schema.tolerances(CATALOGUE), (schema.SURFACE_SLOPE,))
    keys["parameters"] = items(schema.parameter(FAMILY_UNIT))
    for table, meaning in schema.TABLES.items():
        lines += [f"\n**`[{table}]`**: {meaning}\n", *keys.get(table, ())]
    return "\n".join(lines).replace("\n\n\n", "\n\n") + "\n"


def main() -> None:
    print(markdown(), end="")


if __name__ == "__main__":
    main()
