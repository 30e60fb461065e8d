"""Reads a machine file strictly, key by key, and writes one that reads back exactly."""

from __future__ import annotations

import os
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, cast

import tomli_w

from orthoglide import files
from orthoglide.effects import CATALOGUE, Catalogue, catalogue_of
from orthoglide.effects.bumps_and_jumps import with_free_forms
from orthoglide.effects.catalogue import CUSTOM_EFFECTS_HINT
from orthoglide.errors import InputError, as_path, check_type
from orthoglide.geometry import Geometry
from orthoglide.layout import ORTHOGLIDE, FreeLegs, Layout
from orthoglide.machine_file import schema
from orthoglide.machine_file.document import Document, key_hint
from orthoglide.machine_file.model import (
    SCHEMA_VERSION,
    MachineFile,
    ParameterValue,
    default_machine_name,
)
from orthoglide.machine_file.posterior import parse_posterior, posterior_bytes, posterior_path
from orthoglide.notes import Note
from orthoglide.parameters import effect_name
from orthoglide.text import abbreviated, printable_path


class _HasSpec(Protocol):
    """A machine, which a layer above defines."""

    @property
    def spec(self) -> MachineFile:
        """Return the content of its file."""


AnyMachine = MachineFile | _HasSpec | Geometry | str | os.PathLike[str]
"""A machine, the content or path of its file, or dimensions with defaults for all else."""


def machine_file_of(given: AnyMachine | None) -> MachineFile:
    """Return the content of a machine's file; that of the nominal machine for None.

    Raises:
        FileError: naming file, line and remedy.
        InputError: for what is no machine.
    """
    if isinstance(given, str | os.PathLike):
        return read_machine_file(given)
    if isinstance(given, Geometry):
        return MachineFile(name=default_machine_name(given), geometry=given)
    spec: Any = MachineFile() if given is None else getattr(given, "spec", given)
    check_type("the machine", spec, MachineFile, "a Machine, the path of its file or a Geometry")
    machine: MachineFile = spec
    return machine


def read_machine_file(
    path: str | os.PathLike[str], catalogue: Catalogue = CATALOGUE
) -> MachineFile:
    """Return the content of a machine file, SI, with its digest and the covariance from the
    ``.npz`` beside it; of a folder, that of its ``calibrated.toml``. It may name the effects of
    ``catalogue``.

    Raises:
        FileError: naming the line and what would be right, or a covariance of another file.
    """
    path = files.result_file(path, "calibrated.toml")
    content = files.read_bytes(path, files.TEXT_LIMIT)
    machine = parse_machine_file(files.decode(content, path), printable_path(path), catalogue)
    if machine.urdf:
        machine = replace(machine, urdf=str((Path(path).parent / machine.urdf).resolve()))
    digest = files.sha256(content)
    beside, posterior = posterior_path(path), None
    if beside.exists():
        posterior = parse_posterior(files.read_bytes(beside), digest, printable_path(beside))
    warnings = machine.stiffness.warnings(machine.file)
    has_sigmas = any(entry.sigma for entry in machine.parameters.values())
    if posterior is None and machine.is_calibrated and has_sigmas:
        warnings += (Note(
            f"{machine.file}: there is no {printable_path(beside.name)} beside it with the "
            f"covariance of its parameters: their sigmas are taken as independent",
            "covariance",
        ),)  # fmt: skip
    # The covariance may contain parameters of alternatives that the file does not contain.
    names = posterior.names if posterior else ()
    catalogue = with_free_forms(machine.catalogue, names, machine.geometry)
    return replace(
        machine, sha256=digest, posterior=posterior, warnings=warnings, catalogue=catalogue
    )


def parse_machine_file(text: str, file: str = "", catalogue: Catalogue = CATALOGUE) -> MachineFile:
    """Return a machine file from its text; arguments and errors as in `read_machine_file`."""
    document = Document(text, file)
    top = schema.TOP.read(document)
    geometry = _geometry(document)
    catalogue, names = catalogue.for_layout(geometry.layout), document.table("parameters")
    catalogue = with_free_forms(catalogue, names, geometry)
    tolerance = schema.tolerances(catalogue).read(document)
    document.check_keys(schema.INSTRUMENT_KINDS, "instrument")
    machine = MachineFile(
        **{"name": "", **top, **schema.DRIVE.read(document), **schema.CLASS.read(document)},
        **{
            k: section.build_record(document) for k, section in schema.SECTIONS_BY_ATTRIBUTE.items()
        },
        geometry=geometry,
        instruments={
            kind: schema.INSTRUMENT.build_record(document, "instrument", kind)
            for kind in document.table("instrument")
        },
        surface_slope=tolerance.pop("surface_slope", None),
        tolerance=tolerance,
        parameters={name: _parameter(document, name, catalogue) for name in names},
        provenance=tomllib.loads(text)["provenance"] if document.table("provenance") else {},
        catalogue=catalogue,
        file=file,
    )
    if machine.printer and (objection := machine.printer.objection(geometry)):
        document.fail(*objection)
    return machine.with_measured()


def _geometry(document: Document) -> Geometry:
    values, layout = schema.GEOMETRY.read(document), _layout(document)
    in_layout = schema.LAYOUT_R.name in document.table("layout")
    path = ("layout", "r_mm") if in_layout else ("geometry_mm", "r")
    r = document.value(schema.LAYOUT_R.kind.read, *path)
    if values.setdefault("r", r) != r:
        document.fail("r_mm is not the r of [geometry_mm]: keep one", "layout", "r_mm")
    length, (low, high) = values["L"], values["stroke"]
    shortest = min(1e-3, length / 50)  # a micro-stage moves by less than a millimetre
    for key, is_wrong, remedy in (
        ("d", values["d"] >= length, "d is not shorter than L: are they exchanged?"),
        ("r", values["r"] >= length, "r is not shorter than L: are they exchanged?"),
        ("stroke", high - low < shortest, "stroke is too short: give millimetres, not metres"),
        ("stroke", not layout.stroke_fits(length, (low, high)), "the stroke must run from below 0 "
         "to above 0 and stay within L: correct one of them"),
    ):  # fmt: skip
        if is_wrong:
            document.fail(remedy, "geometry_mm", key)
    try:
        return Geometry(**values, layout=layout)
    except InputError as error:
        document.fail(str(error), "layout")


def _layout(document: Document) -> Layout:
    if not document.table("layout"):
        return ORTHOGLIDE
    section = schema.LAYOUTS[document.value(schema.KIND.kind.read, "layout", "kind")]
    if section.record_class is not FreeLegs:
        return cast(Layout, section.build_record(document))
    section.read(document)  # reports an unknown key, which may be a misspelt leg
    names, path = document.table("layout", "leg"), ("layout", "leg")
    if len(names) != 3:
        document.fail(f"has {len(names)} legs: give three tables, [layout.leg.NAME]", *path)
    legs = tuple(schema.LEG.build_record(document, *path, name, name=name) for name in names)
    return cast(Layout, section.build_record(document, free=legs))


def _parameter(document: Document, name: str, catalogue: Catalogue) -> ParameterValue:
    path = ("parameters", name)
    effect = effect_name(name)
    allowed = [other for other, entry in catalogue.items() if not entry.of_dial]
    if effect not in allowed:
        hint = key_hint(effect, allowed)
        where = f"(effects of {CUSTOM_EFFECTS_HINT})"
        document.fail(f"there is no parameter {abbreviated(name)!r}: {hint} {where}", *path)
    if name not in catalogue[effect].motions:  # a file holds no structured members
        document.fail(
            f"{abbreviated(name)!r} names no parameter of {effect}: correct what follows it", *path
        )
    section = schema.parameter(catalogue[effect].unit)
    return cast(ParameterValue, section.build_record(document, *path))


# -- writing --------------------------------------------------------------------------------------


def write_machine_file(
    machine: MachineFile, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a machine file that reads back exactly, with its covariance beside it under the same
    name with ``.npz``. They are written completely, or, where nothing is replaced, none is.

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
        files.check_new(covariance_file)  # it would be read as this machine's
    elif machine.posterior is None:
        with files.as_file_errors(covariance_file):
            covariance_file.unlink(missing_ok=True)
    files.write_files(
        {target.with_name(n): content for n, content in contents.items()}, overwrite=overwrite
    )


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
    lines = ["", "[parameters]"] if machine.parameters else []
    for name, value in machine.parameters.items():  # inline, as the TOML writer takes four lines
        table = schema.parameter(machine.catalogue.effect_of(name).unit).write(value)
        lines.append(f'"{name}" = {{ {", ".join(tomli_w.dumps(table).splitlines())} }}')
    try:
        text = tomli_w.dumps(_toml_tables(machine)) + "".join(f"{line}\n" for line in lines)
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
