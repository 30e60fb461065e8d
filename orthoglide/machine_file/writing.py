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

    Each file is written completely or not at all; a missing one is reported on reading.

    Args:
        machine: what to write.
        path: of the machine file; the covariance goes to the same name with ``.npz``.
        overwrite: whether existing files may be replaced.

    Raises:
        FileError: if a file exists and may not be replaced, or cannot be written.
        InputError: if a machine file cannot hold the machine.
    """
    target = as_path(path)
    if machine.urdf:  # relative to the file, so that both may move together
        relative = os.path.relpath(machine.urdf, target.resolve().parent)
        machine = replace(machine, urdf=Path(relative).as_posix())
    contents = machine_file_contents(machine, str(path))
    covariance_file = posterior_path(target)
    if not overwrite:
        files.check_new(target)
        files.check_new(covariance_file)  # it would be read as this machine's
    elif machine.posterior is None:
        with files.as_file_errors(covariance_file):
            covariance_file.unlink(missing_ok=True)
    for name, content in reversed(contents.items()):
        files.write_file(target.with_name(name), content, overwrite=overwrite)


def machine_file_contents(machine: MachineFile, path: str) -> dict[str, str | bytes]:
    """Return the contents of the machine file and, if known, of the covariance file, by name.

    Raises:
        InputError: if a machine file cannot hold the machine.
    """
    text = machine_text(machine, path)
    contents: dict[str, str | bytes] = {Path(path).name: text}
    if machine.posterior is not None:
        digest = files.sha256(text.encode())
        contents[posterior_path(path).name] = posterior_bytes(machine.posterior, digest)
    return contents


def machine_text(machine: MachineFile, file: str = "") -> str:
    """Return the text of a machine file, which reads back exactly; errors name the ``file``.

    Raises:
        InputError: if a machine file cannot hold the machine.
    """
    import tomli_w

    try:
        tables = tomli_w.dumps(_toml_tables(machine))
        text = _averaging_comment(machine) + tables + _parameter_lines(machine)
    except TypeError as error:
        raise InputError(f"a machine file cannot hold this provenance: {error}") from None
    # What could not be read back is never written.
    reread = parse_machine_file(text, file, machine.catalogue)
    if replace(reread, provenance=machine.provenance) != machine:
        raise InputError("a machine file cannot hold this machine: it would read back differently")
    return text


def _toml_tables(machine: MachineFile) -> dict[str, Any]:
    catalogue, layout = machine.catalogue, machine.geometry.layout
    tolerance = {
        name: value
        for name, value in machine.tolerance.items()
        # Default tolerances of a user's effects are left out: a file with them needs the effects.
        if name in catalogue_of(catalogue.legs) or value != catalogue.default_tolerance.get(name)
    }
    tables = {
        s.name: s.write(getattr(machine, name)) for name, s in schema.SECTIONS_BY_ATTRIBUTE.items()
    } | {
        "geometry_mm": schema.GEOMETRY.write(machine.geometry),
        "instrument": {k: schema.INSTRUMENT.write(i) for k, i in machine.instruments.items()},
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
    """Return a comment on values that are averages over alternatives; else empty."""
    rivals = machine.provenance.get("averaged_over")
    if not isinstance(rivals, list | tuple) or not rivals:
        return ""
    effects = machine.provenance.get("effects", ())
    names = ", ".join(map(str, dict.fromkeys((*effects, *rivals))))
    lines = textwrap.wrap(
        f"Averages: the readings cannot tell {names} apart. The values below are the mean over "
        f"these explanations, each weighed with its probability, and describe none of them alone.",
        98,
    )
    return "".join(f"# {line}\n" for line in lines) + "\n"


def _parameter_lines(machine: MachineFile) -> str:
    """Return an inline table for each parameter, where the TOML writer would take four lines."""
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
