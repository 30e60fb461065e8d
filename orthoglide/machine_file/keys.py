"""Keys and tables of a file that are stated once: they are read, checked and written by them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from orthoglide.errors import InputError
from orthoglide.machine_file.document import Document
from orthoglide.quantities import Kind


@dataclass(frozen=True)
class Key:
    """One key of a section.

    Attributes:
        name: in the file, with its unit where the section's name does not say it.
        kind: what its value is.
        meaning: sentences for the documentation.
        required: whether a file must have it.
        attribute: what holds it in Python: the name without ``_mm`` if empty, nothing if None.
    """

    name: str
    kind: Kind
    meaning: str
    required: bool = False
    attribute: str | None = ""

    @property
    def held(self) -> str | None:
        """Return the name of the attribute that holds the value in Python."""
        return self.name.removesuffix("_mm") if self.attribute == "" else self.attribute


@dataclass(frozen=True)
class Section:
    """A table of a file.

    Attributes:
        name: in the file; empty for the keys outside any table.
        record: the class whose attributes hold its values.
        keys: in the order of writing.
        tables: names of the tables within it.
    """

    name: str
    record: type
    keys: tuple[Key, ...]
    tables: tuple[str, ...] = ()

    def read(self, document: Document, *path: str) -> dict[str, Any]:
        """Return the values of a table in SI by attribute; the path is the section's name if empty.

        Raises:
            FileError: for an unknown key, a missing key and a wrong value.
        """
        path = path or ((self.name,) if self.name else ())
        document.check_keys((*(key.name for key in self.keys), *self.tables), *path)
        found = {}
        for key in self.keys:
            if key.required or key.name in document.table(*path):
                found[key.held] = document.value(key.kind.read, *path, key.name)
        return {name: value for name, value in found.items() if name is not None}

    def build(self, document: Document, *path: str, **further: Any) -> Any:
        """Return the record of a table, with further values; arguments as for `read`.

        Raises:
            FileError: as `read`, and for what the record refuses.
        """
        values = self.read(document, *path)
        try:
            return self.record(**values, **further)
        except InputError as error:
            document.fail(str(error), *(path or (self.name,)))

    def write(self, record: Any) -> dict[str, Any]:
        """Return a table of the file from the attributes of a record, without those of None."""
        values = record if isinstance(record, Mapping) else vars(record)
        given = ((key, values.get(key.held)) for key in self.keys)
        return {key.name: key.kind.write(value) for key, value in given if value is not None}
