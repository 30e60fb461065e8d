"""Writes a machine file that reads back exactly."""

from __future__ import annotations

import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from orthoglide import files, units
from orthoglide.effects import catalogue_of
from orthoglide.errors import InputError, path_of
from orthoglide.geometry import Geometry
from orthoglide.layout import FreeLegs, LinearDelta
from orthoglide.machine_file.model import SCHEMA, MachineFile
from orthoglide.machine_file.posterior import posterior_bytes, posterior_path
from orthoglide.machine_file.reading import parse_machine_file


def write_machine_file(
    machine: MachineFile, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Writes a machine file that reads back exactly, with its covariance beside it.

    Each file appears whole or not at all; one without the other is told on reading.

    Args:
        machine: what to write.
        path: where to; the covariance goes to the same name with ``.npz``.
        overwrite: whether existing files may be replaced.

    Raises:
        FileError: where a file stands already and may not be replaced, or none can be written.
        InputError: where the machine holds what no machine file can.
    """
    target = path_of(path)
    if machine.urdf:  # seen from the file, so that both may move together
        seen = os.path.relpath(machine.urdf, target.resolve().parent)
        machine = replace(machine, urdf=Path(seen).as_posix())
    contents = machine_files(machine, str(path))
    beside = posterior_path(target)
    if not overwrite:
        files.check_new(target)
        files.check_new(beside)  # it would be taken for this machine's
    elif machine.posterior is None:
        with files.writing(beside):
            beside.unlink(missing_ok=True)
    for name, content in reversed(contents.items()):
        files.write_whole(target.with_name(name), content, overwrite=overwrite)


def machine_files(machine: MachineFile, path: str) -> dict[str, str | bytes]:
    """A machine file and, where its covariance is known, the file of that, by name.

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
    """The text of a machine file, which reads back exactly; errors name the ``file``.

    Raises:
        InputError: where the machine holds what no machine file can.
    """
    import tomli_w

    try:
        text = tomli_w.dumps(_tables(machine)) + _parameter_lines(machine)
    except TypeError as error:
        raise InputError(f"a machine file cannot hold this provenance: {error}") from None
    # What could not be read back is never written.
    again = parse_machine_file(text, file, machine.catalogue)
    if replace(again, provenance=machine.provenance) != machine:
        raise InputError("a machine file cannot hold this machine: it would read back differently")
    return text


def _mm(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_mm(inner) for inner in value]
    return None if value is None else units.from_si(value, 1e-3)


def _layout(geometry: Geometry) -> dict[str, Any]:
    layout = geometry.layout
    if isinstance(layout, FreeLegs):
        tables = {
            leg.name: {
                "origin_mm": _mm(leg.origin), "slide": list(leg.slide), "link": list(leg.link)
            }
            for leg in layout.free
        }  # fmt: skip
        return {"kind": layout.kind, "tool_mm": _mm(layout.tool), "leg": tables}
    if not isinstance(layout, LinearDelta):
        return {}
    return {
        "kind": layout.kind,
        "radius_mm": _mm(layout.radius),
        "angles_deg": list(layout.angles_deg),
        "tool_mm": _mm(layout.tool),
    }


def _tables(machine: MachineFile) -> dict[str, Any]:
    stiffness, controller, catalogue = machine.stiffness, machine.controller, machine.catalogue
    bar = None if stiffness.bar is None else units.from_si(stiffness.bar, 1e3)
    tables: dict[str, Any] = {
        "geometry_mm": {n: _mm(getattr(machine.geometry, n)) for n in ("L", "d", "r", "stroke")},
        "layout": _layout(machine.geometry),
        "dial_mm": {key: _mm(value) for key, value in asdict(machine.dial).items()},
        "instrument": {
            kind: {k: v for k, v in ((k, _mm(v)) for k, v in asdict(one).items()) if v is not None}
            for kind, one in machine.instruments.items()
        },
        "drive": {"screw_pitch_mm": _mm(machine.screw_pitch)},
        "controller": {"zero_mm": _mm(controller.zero), "sign": list(controller.sign)},
        "tolerance": {
            name: units.from_si(value, catalogue.effect_of(name).unit.si)
            for name, value in machine.tolerance.items()
            # Without need of it, a file that names a user's effect could not be read alone.
            if name in catalogue_of(catalogue.legs)
            or value != catalogue.default_tolerance.get(name)
        },
        "stiffness": {"torsion_Nmm_per_rad": _mm(stiffness.torsion), "bar_N_per_mm": bar},
    }
    given = {
        name: {key: value for key, value in table.items() if value is not None}
        for name, table in tables.items()
    }
    kept = {name: table for name, table in given.items() if table}
    urdf = {"urdf": machine.urdf} if machine.urdf else {}
    top = {"schema": SCHEMA, "name": machine.name, **urdf, **kept}
    return {**top, "provenance": dict(machine.provenance)} if machine.provenance else top


def _float(value: float, factor: float) -> str:
    text = str(units.from_si(value, factor))
    return text if set(text) & set(".EN") else f"{text}.0"  # a whole number would lose its -0


def _parameter_lines(machine: MachineFile) -> str:
    """One inline table a parameter, which the TOML writer would spread over four lines."""
    if not machine.parameters:
        return ""
    lines = ["", "[parameters]"]
    for name, parameter in machine.parameters.items():
        factor = machine.catalogue.effect_of(name).unit.si
        value, sigma = (_float(v, factor) for v in (parameter.value, parameter.sigma))
        lines.append(
            f'"{name}" = {{ value = {value}, sigma = {sigma}, unit = "{parameter.unit}" }}'
        )
    return "\n".join(lines) + "\n"
