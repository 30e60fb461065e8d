"""Reads a machine file strictly: every key is checked and none is ignored."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any, Protocol

from orthoglide import files, units
from orthoglide.effects import CATALOGUE, Catalogue
from orthoglide.effects.catalogue import OWN
from orthoglide.effects.places import with_places
from orthoglide.errors import InputError
from orthoglide.geometry import Geometry
from orthoglide.instruments import INSTRUMENTS
from orthoglide.layout import ORTHOGLIDE, FreeLeg, FreeLegs, Layout, LinearDelta
from orthoglide.machine_file.document import Document, Parser, advice
from orthoglide.machine_file.model import (
    SCHEMA,
    Controller,
    Dial,
    Instrument,
    MachineFile,
    ParameterValue,
    Stiffness,
    name_of,
)
from orthoglide.machine_file.posterior import parse_posterior, posterior_path
from orthoglide.machine_file.travel import check_travel
from orthoglide.parameters import effect_name
from orthoglide.text import brief, shown


def _number(value: Any) -> Decimal:
    if isinstance(value, bool) or not isinstance(value, int | Decimal):
        raise ValueError("must be a number")
    if not Decimal(value).is_finite():
        raise ValueError("must be a finite number")
    return Decimal(value)


def _quantity(
    factor: float, low: float = 0.0, high: float = 1e4, open_end: bool = True
) -> Callable[[Any], float]:
    def parse(value: Any) -> float:
        number = _number(value)
        if not (low < number < high or (number == low and not open_end)):
            bound = "above" if open_end else "at least"
            hint = ": is it in metres?" if factor == 1e-3 and 0 < number <= low else ""
            raise ValueError(
                f"must be {bound} {low:g} and below {high:g}, not {float(number):g}{hint}"
            )
        return units.to_si(number, factor)

    return parse


def _millimetres(count: int) -> Callable[[Any], tuple[float, ...]]:
    def parse(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise ValueError(f"must be a list of {count} numbers in mm")
        if any(abs(_number(v)) > 1e4 for v in value):
            raise ValueError("must hold no more than 10000 mm")
        return tuple(units.to_si(v, 1e-3) for v in value)

    return parse


def _stroke(value: Any) -> tuple[float, ...]:
    low, high = stroke = _millimetres(2)(value)
    if low > high:
        raise ValueError("is reversed: give the lower limit first")
    if low > 0:
        raise ValueError("must be counted from mechanical zero, from below 0 to above 0")
    return stroke


def _signs(value: Any) -> tuple[int, ...]:
    if not isinstance(value, list) or len(value) != 3 or any(v not in (1, -1) for v in value):
        raise ValueError("must be a list of three, each 1 or -1")
    return tuple(int(v) for v in value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError("must be text in quotes")
    return value


def _schema(value: Any) -> int:
    if isinstance(value, bool) or value != SCHEMA:
        raise ValueError(f"must be {SCHEMA}, the only version this program knows")
    return SCHEMA


def _three(parse: Parser) -> Parser:
    """Three numbers, or one for all."""

    def parse_three(value: Any) -> tuple[Any, ...]:
        several = value if isinstance(value, list) else [value] * 3
        if len(several) != 3:
            raise ValueError("must be a number or a list of three")
        return tuple(parse(v) for v in several)

    return parse_three


def _angle(value: Any) -> float:
    if abs(_number(value)) > 3600:
        raise ValueError("must be angles in degrees")
    return float(_number(value))


def _direction(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError("must be a direction, a list of three numbers")
    if any(abs(_number(v)) > 1e6 for v in value):
        raise ValueError("must be a direction of moderate numbers")
    return tuple(float(v) for v in value)


_KEYS: dict[str, dict[str, Parser]] = {
    "geometry_mm": {
        "L": _quantity(1e-3, 5),
        "d": _quantity(1e-3, 1),
        "r": _quantity(1e-3, 1),
        "stroke": _stroke,
    },
    "dial_mm": {
        "resolution": _quantity(1e-3, 5e-5, 10),
        "repeatability": _quantity(1e-3, 1e-7, units.NOISE[1] / 1e-3),
        "placement": _quantity(1e-3, 0, 100, open_end=False),
    },
    "drive": {"screw_pitch_mm": _quantity(1e-3, 0.1, 1000)},
    "controller": {"zero_mm": _millimetres(3), "sign": _signs},
    "stiffness": {
        "torsion_Nmm_per_rad": _quantity(1e-3, 0, 1e15, open_end=False),
        "bar_N_per_mm": _quantity(1e3, 0, 1e15),
    },
}
_LAYOUTS: dict[str, dict[str, Parser]] = {
    "orthoglide": {},
    "linear-delta": {
        "radius_mm": _three(_quantity(1e-3, 1)),
        "angles_deg": _three(_angle),
        "r_mm": _quantity(1e-3, 1),
        "tool_mm": _millimetres(3),
    },
    "legs": {
        "r_mm": _quantity(1e-3, 1),
        "tool_mm": _millimetres(3),
        "leg": lambda value: value,
    },
}
_LEG: dict[str, Parser] = {
    "origin_mm": _millimetres(3),
    "slide": _direction,
    "link": _direction,
}
_INSTRUMENT: dict[str, Parser] = {
    "resolution": _quantity(1e-3, 0, 10),
    "repeatability": _quantity(1e-3, 0, 10),
}
_TOP: dict[str, Parser] = {"schema": _schema, "name": _text, "urdf": _text}
_FREE = ("tolerance", "parameters", "provenance", "layout", "instrument")


class _Specified(Protocol):
    """A machine, which is known above."""

    @property
    def spec(self) -> MachineFile:
        """What its file holds."""


AnyMachine = MachineFile | _Specified | Geometry | str | os.PathLike[str]
"""A machine, its file as read, the path of that, or dimensions with all else as usual."""


def machine_file_of(given: AnyMachine | None) -> MachineFile:
    """What is known of a machine; of the nominal one where none is given.

    Raises:
        FileError: naming file, line and remedy.
        InputError: for what is none.
    """
    if isinstance(given, str | os.PathLike):
        return read_machine_file(given)
    if isinstance(given, Geometry):
        return MachineFile(name=name_of(given), geometry=given)
    found = MachineFile() if given is None else getattr(given, "spec", given)
    if not isinstance(found, MachineFile):
        raise InputError(
            f"a {type(given).__name__} is no machine: give a Machine, the path of its file, or a "
            f"Geometry"
        )
    return found


def read_machine_file(
    path: str | os.PathLike[str], catalogue: Catalogue = CATALOGUE
) -> MachineFile:
    """Reads a machine file.

    Args:
        path: the file (TOML, UTF-8), or the folder of a result with its ``calibrated.toml``.
        catalogue: the effects that it may name.

    Returns:
        Its content in SI, with its digest, and the covariance kept in the ``.npz`` beside it.

    Raises:
        FileError: naming the line and what would be right, or a covariance of another file.
    """
    path = files.inside(path, "calibrated.toml")
    content = files.read_bytes(path, files.TEXT)
    machine = parse_machine_file(files.decode(content, path), shown(path), catalogue)
    if machine.urdf:
        machine = replace(machine, urdf=str((Path(path).parent / machine.urdf).resolve()))
    digest = files.sha256(content)
    beside, posterior = posterior_path(path), None
    if beside.exists():
        posterior = parse_posterior(files.read_bytes(beside), digest, shown(beside))
    layout, geometry = machine.geometry.layout, machine.geometry
    near, within = (
        layout.touching(geometry.L, geometry.r) if isinstance(layout, FreeLegs) else ((), 0.0)
    )
    warnings = tuple(
        f"{machine.file}: by L, r and origin_mm the joint of leg {name} on the platform lies on "
        f"the line from origin_mm to the platform's middle to within {within * 1e3:.1g} mm of "
        f"these lengths: it is taken to lie on that line"
        for name in near
    )
    warnings += machine.stiffness.warnings(machine.file)
    if posterior is None and any(entry.sigma for entry in machine.parameters.values()):
        warnings += (
            f"{machine.file}: there is no {shown(beside.name)} beside it with the covariance of "
            f"its parameters: their sigmas are taken as independent",
        )
    # An explanation that the file does not take may have a place in the covariance all the same.
    catalogue = with_places(machine.catalogue, posterior.names if posterior else (), geometry)
    return replace(
        machine, sha256=digest, posterior=posterior, warnings=warnings, catalogue=catalogue
    )


def parse_machine_file(text: str, file: str = "", catalogue: Catalogue = CATALOGUE) -> MachineFile:
    """A machine file from its text; ``file`` is its name for errors, as in `read_machine_file`."""
    document = Document(text, file)
    document.check_keys((*_TOP, *_KEYS, *_FREE))
    top = document.section(_TOP, ("schema",))
    sections = {name: _section(document, name) for name in _KEYS}
    controller, stiffness = sections["controller"], sections["stiffness"]
    geometry = _geometry(document, sections["geometry_mm"])
    provenance = _plain(document.table("provenance"))
    check_travel(document, geometry, provenance)
    catalogue, named = catalogue.of_layout(geometry.layout), document.table("parameters")
    catalogue = with_places(catalogue, named, geometry)
    return MachineFile(
        name=top.get("name", ""),
        geometry=geometry,
        dial=Dial(**sections["dial_mm"]),
        instruments=_instruments(document),
        screw_pitch=sections["drive"].get("screw_pitch_mm"),
        controller=Controller(**{key.removesuffix("_mm"): v for key, v in controller.items()}),
        tolerance=_tolerance(document, catalogue),
        stiffness=Stiffness(stiffness.get("torsion_Nmm_per_rad"), stiffness.get("bar_N_per_mm")),
        urdf=top.get("urdf", ""),
        parameters={name: _parameter(document, name, catalogue) for name in named},
        provenance=provenance,
        catalogue=catalogue,
        file=file,
    )


def _section(document: Document, name: str) -> dict[str, Any]:
    document.check_keys(_KEYS[name], name)
    skipped = {"r"} if "r_mm" in document.table("layout") else set()
    required = [k for k in _KEYS[name] if k not in skipped] if name == "geometry_mm" else ()
    return document.section(_KEYS[name], required, name)


def _geometry(document: Document, values: dict[str, Any]) -> Geometry:
    layout, r = _layout(document)
    if values.setdefault("r", r) != (r or values["r"]):
        document.fail("r_mm is not the r of [geometry_mm]: keep one", "layout", "r_mm")
    for key in ("d", "r"):
        if values[key] >= values["L"]:
            document.fail(f"{key} is not shorter than L: are they exchanged?", "geometry_mm", key)
    low, high = values["stroke"]
    if high - low < min(1e-3, values["L"] / 50):  # a micro-stage moves by less than a millimetre
        document.fail("stroke is too short: give millimetres, not metres", "geometry_mm", "stroke")
    if not layout.stroke_fits(values["L"], values["stroke"]):
        document.fail(
            "the stroke must run from below 0 to above 0 and stay within L: correct one of them",
            "geometry_mm",
            "stroke",
        )
    try:
        return Geometry(**values, layout=layout)
    except InputError as error:
        document.fail(str(error), "layout")


def _layout(document: Document) -> tuple[Layout, float | None]:
    """The layout, and the platform's radius where it stands there."""
    table = document.table("layout")
    if not table:
        return ORTHOGLIDE, None
    kind = document.section({"kind": _text}, ("kind",), "layout")["kind"]
    if kind not in _LAYOUTS:
        document.fail(f"there is no layout {kind!r}: {advice(kind, _LAYOUTS)}", "layout", "kind")
    document.check_keys(("kind", *_LAYOUTS[kind]), "layout")
    if kind == "orthoglide":
        return ORTHOGLIDE, None
    if kind == "legs":
        return _free_legs(document)
    found = document.section(_LAYOUTS[kind], ("radius_mm",), "layout")
    r = found.pop("r_mm", None)
    try:
        return LinearDelta(**{key.removesuffix("_mm"): v for key, v in found.items()}), r
    except InputError as error:
        document.fail(str(error), "layout")


def _free_legs(document: Document) -> tuple[Layout, float | None]:
    found, names = document.section(_LAYOUTS["legs"], (), "layout"), document.table("layout", "leg")
    if len(names) != 3:
        document.fail(
            f"has {len(names)} legs: give three tables, [layout.leg.NAME]", "layout", "leg"
        )
    legs = []
    for name in names:
        document.check_keys(_LEG, "layout", "leg", name)
        given = document.section(_LEG, tuple(_LEG), "layout", "leg", name)
        try:
            legs.append(FreeLeg(name, given["origin_mm"], given["slide"], given["link"]))
        except InputError as error:
            document.fail(str(error), "layout", "leg", name)
    try:
        return FreeLegs((legs[0], legs[1], legs[2]), found.get("tool_mm", (0.0, 0.0, 0.0))), (
            found.get("r_mm")
        )
    except InputError as error:
        document.fail(str(error), "layout", "leg")


def _instruments(document: Document) -> dict[str, Instrument]:
    document.check_keys(INSTRUMENTS, "instrument")
    found = {}
    for kind in document.table("instrument"):
        document.check_keys(_INSTRUMENT, "instrument", kind)
        found[kind] = Instrument(**document.section(_INSTRUMENT, (), "instrument", kind))
    return found


def _tolerance(document: Document, catalogue: Catalogue) -> dict[str, float]:
    document.check_keys(catalogue, "tolerance")
    return {
        name: document.value(_quantity(catalogue[name].unit.si, 0, 1e6), "tolerance", name)
        for name in document.table("tolerance")
    }


def _parameter(document: Document, name: str, catalogue: Catalogue) -> ParameterValue:
    path = ("parameters", name)
    effect = effect_name(name)
    allowed = [other for other, entry in catalogue.items() if not entry.of_dial]
    if effect not in allowed:
        told = advice(effect, allowed)
        document.fail(f"there is no parameter {brief(name)!r}: {told} (effects of {OWN})", *path)
    if name not in catalogue[effect].motions and name not in catalogue.structured(effect):
        document.fail(
            f"{brief(name)!r} names no parameter of {effect}: correct what follows it", *path
        )
    keys = ("value", "sigma", "unit")
    document.check_keys(keys, *path)
    unit = document.section({"unit": _text}, keys, *path)["unit"]
    expected = catalogue[effect].unit
    if unit != expected.name:
        document.fail(
            f"{name!r} is in {expected.name}, not {brief(unit)}: convert it", *path, "unit"
        )
    factor = expected.si
    value = document.value(_quantity(factor, -1e9, 1e9), *path, "value")
    sigma = document.value(_quantity(factor, 0, 1e9, open_end=False), *path, "sigma")
    return ParameterValue(value, sigma, unit)


def _plain(value: Any) -> Any:
    """A free table with ordinary floats."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    return float(value) if isinstance(value, Decimal) else value
