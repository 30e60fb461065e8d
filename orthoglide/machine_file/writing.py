"""Writes a machine file that reads back exactly."""

from __future__ import annotations

import os
import textwrap
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

from orthoglide import files
from orthoglide.effects import catalogue_of
from orthoglide.errors import InputError, as_path
from orthoglide.layout import ORTHOGLIDE, FreeLegs
from orthoglide.machine_file import schema
from orthoglide.machine_file.model import SCHEMA_VERSION, MachineFile
from orthoglide.machine_file.posterior import posterior_bytes, posterior_path
from orthoglide.machine_file.reading import parse_machine_file


def write_machine_file(
    machine: MachineFile, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a machine file that reads back exactly, with its covariance beside it.

    Each file appears whole or not at all; one without the other is reported on reading.

    Args:
        machine: what to write.
        path: where to; the covariance goes to the same name with ``.npz``.
        overwrite: whether existing files may be replaced.

    Raises:
        FileError: where a file stands already and may not be replaced, or none can be written.
        InputError: where the machine holds what no machine file can.
    """
    target = as_path(path)
    if machine.urdf:  # seen from the file, so that both may move together
        seen = os.path.relpath(machine.urdf, target.resolve().parent)
        machine = replace(machine, urdf=Path(seen).as_posix())
    contents = machine_file_contents(machine, str(path))
    beside = posterior_path(target)
    if not overwrite:
        files.check_new(target)
        files.check_new(beside)  # it would be taken for this machine's
    elif machine.posterior is None:
        with files.as_file_errors(beside):
            beside.unlink(missing_ok=True)
    for name, content in reversed(contents.items()):
        files.write_file(target.with_name(name), content, overwrite=overwrite)


def machine_file_contents(machine: MachineFile, path: str) -> dict[str, str | bytes]:
    """Return a machine file and, where its covariance is known, the file of that, by name.

    Raises:
        InputError: where the machine holds what no machine file can.
    """
    text = machine_text(machine, path)
    found: dict[str, str | bytes] = {Path(path).name: text}
    if machine.posterior is not None:
        found[posterior_path(path).name] = posterior_bytes(
            machine.posterior, files.sha256(text.encode())
        )
    return found


def machine_text(machine: MachineFile, file: str = "") -> str:
    """Return the text of a machine file, which reads back exactly; errors name the ``file``.

    Raises:
        InputError: where the machine holds what no machine file can.
    """
    import tomli_w

    try:
        text = (
            _averaging_comment(machine)
            + tomli_w.dumps(_toml_tables(machine))
            + _parameter_lines(machine)
        )
    except TypeError as error:
        raise InputError(f"a machine file cannot hold this provenance: {error}") from None
    # What could not be read back is never written.
    again = parse_machine_file(text, file, machine.catalogue)
    if replace(again, provenance=machine.provenance) != machine:
        raise InputError("a machine file cannot hold this machine: it would read back differently")
    return text


def _toml_tables(machine: MachineFile) -> dict[str, Any]:
    catalogue, layout = machine.catalogue, machine.geometry.layout
    tolerance = {
        name: value
        for name, value in machine.tolerance.items()
        # Without need of it, a file that names a user's effect could not be read alone.
        if name in catalogue_of(catalogue.legs) or value != catalogue.default_tolerance.get(name)
    }
    tables = {
        p.name: p.write(getattr(machine, name)) for name, p in schema.SECTIONS_BY_ATTRIBUTE.items()
    } | {
        "geometry_mm": schema.GEOMETRY.write(machine.geometry),
        "instrument": {k: schema.INSTRUMENT.write(one) for k, one in machine.instruments.items()},
        "drive": schema.DRIVE.write(machine),
        "class": {"kind": machine.build} if machine.build else {},
        "tolerance": schema.tolerances(catalogue).write(
            tolerance | {"surface_slope": machine.surface_slope}
        ),
        "provenance": dict(machine.provenance),
    }
    if layout != ORTHOGLIDE:
        tables["layout"] = {"kind": layout.kind, **schema.LAYOUTS[layout.kind].write(layout)}
    if isinstance(layout, FreeLegs):
        tables["layout"]["leg"] = {leg.name: schema.LEG.write(leg) for leg in layout.free}
    written = {name: tables[name] for name in schema.TABLES if tables.get(name)}
    top = schema.TOP.write(vars(machine) | {"urdf": machine.urdf or None})
    return {"schema": SCHEMA_VERSION, **top, **written}


def _averaging_comment(machine: MachineFile) -> str:
    """What a reader of the values must know first, as a comment; empty where it is nothing."""
    rivals = machine.provenance.get("averaged_over")
    if not isinstance(rivals, list | tuple) or not rivals:
        return ""
    found = machine.provenance.get("effects", ())
    names = ", ".join(map(str, dict.fromkeys((*found, *rivals))))
    lines = textwrap.wrap(
        f"Averages: the readings cannot tell {names} apart. The values below are the mean over "
        f"these explanations, each weighed with its probability, and describe none of them alone.",
        98,
    )
    return "".join(f"# {line}\n" for line in lines) + "\n"


def _parameter_lines(machine: MachineFile) -> str:
    """Return an inline table for each parameter; the TOML writer would take four lines for it."""
    lines = ["", "[parameters]"] if machine.parameters else []
    for name, value in machine.parameters.items():
        table = schema.parameter(machine.catalogue.effect_of(name).unit).write(value)
        cells = ", ".join(f"{key} = {_toml_literal(cell)}" for key, cell in table.items())
        lines.append(f'"{name}" = {{ {cells} }}')
    return "".join(f"{line}\n" for line in lines)


def _toml_literal(value: str | Decimal) -> str:
    """Return a value as TOML has it: text in quotes, or a number with its point."""
    if isinstance(value, str):
        return f'"{value}"'
    text = str(value)
    return text if set(text) & set(".EN") else f"{text}.0"
