"""Reads a machine file strictly: every key is checked and none is ignored."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Protocol, cast

from orthoglide import files
from orthoglide.effects import CATALOGUE, Catalogue
from orthoglide.effects.bumps_and_jumps import with_free_forms
from orthoglide.effects.catalogue import CUSTOM_EFFECTS_HINT
from orthoglide.errors import InputError
from orthoglide.geometry import Geometry
from orthoglide.layout import ORTHOGLIDE, FreeLegs, Layout
from orthoglide.machine_file import schema
from orthoglide.machine_file.document import Document, key_hint
from orthoglide.machine_file.model import MachineFile, ParameterValue, default_machine_name
from orthoglide.machine_file.posterior import parse_posterior, posterior_path
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
    machine = MachineFile() if given is None else getattr(given, "spec", given)
    if not isinstance(machine, MachineFile):
        raise InputError(
            f"a {type(given).__name__} is no machine: give a Machine, the path of its file, or a "
            f"Geometry"
        )
    return machine


def read_machine_file(
    path: str | os.PathLike[str], catalogue: Catalogue = CATALOGUE
) -> MachineFile:
    """Return the content of a machine file and of the covariance file beside it.

    Args:
        path: the file (TOML, UTF-8), or the folder of a result with its ``calibrated.toml``.
        catalogue: the effects that it may name.

    Returns:
        The content in SI, with its digest and the covariance from the ``.npz`` beside it.

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
    if posterior is None and not machine.is_measured and has_sigmas:
        warnings += (
            f"{machine.file}: there is no {printable_path(beside.name)} beside it with the "
            f"covariance of its parameters: their sigmas are taken as independent",
        )
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
        provenance=document.plain_table("provenance"),
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
    if name not in catalogue[effect].motions and name not in catalogue.structured_members(effect):
        document.fail(
            f"{abbreviated(name)!r} names no parameter of {effect}: correct what follows it", *path
        )
    section = schema.parameter(catalogue[effect].unit)
    return cast(ParameterValue, section.build_record(document, *path))
