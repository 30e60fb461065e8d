"""The schema of the machine file: every table and key, stated once.

Reading, checking and writing use these tables, and the reference in ``docs/files.md`` is printed
from them.
"""

from __future__ import annotations

from orthoglide.effects import Catalogue
from orthoglide.effects.catalogue import MACHINE_CLASSES
from orthoglide.geometry import Geometry
from orthoglide.instruments import OBSERVATIONS
from orthoglide.layout import FreeLeg, FreeLegs, LinearDelta, Orthoglide
from orthoglide.machine_file import model
from orthoglide.machine_file.document import TEXT, Key, Section, list_of, one_of, quantity
from orthoglide.units import MM, NOISE_LIMITS, ONE, RAD, Unit

INSTRUMENT_KINDS = tuple(name for name, kind in OBSERVATIONS.items() if kind.dials != 1)
"""Kinds of readings that may have a table; one dial on a leg has ``[dial_mm]``."""

_LENGTH = quantity(MM, -1e4, 1e4, closed=True)
_POINT = list_of(_LENGTH, 3)
_DIRECTION = list_of(quantity(ONE, -1e6, 1e6, closed=True), 3)
_ANGLE = quantity(Unit("deg", 1.0), -3600, 3600, closed=True)
_PLATFORM_RADIUS = quantity(MM, 1)
_POSITIVE_LENGTH = quantity(MM, 0, 1e4)
_MAX_STIFFNESS = 1e15  # in the file's units: beyond any part

TABLES = {
    "geometry_mm": "Nominal dimensions.",
    "layout": "Where the legs stand. Its keys depend on its kind.",
    "dial_mm": "The dial on the legs.",
    "instrument": "Other instruments, with a table `[instrument.KIND]` for each kind of reading: "
    f"{', '.join(f'`{kind}`' for kind in INSTRUMENT_KINDS)}.",
    "drive": "The drives.",
    "controller": "How the controller counts.",
    "class": "How the machine is built, which sets the tolerances that are not given.",
    "measured": "What was measured on the machine itself, each a list of a length and its standard "
    "deviation.",
    "tolerance": "Standard deviations to expect, one number an effect. Names, units and defaults "
    "are those of the [catalogue](effects.md).",
    "stiffness": "Elastic constants.",
    "provenance": "Where the parameters come from: any keys.",
    "parameters": "Parameters of a calibrated machine, with an inline table for each.",
}
"""The tables of a file in the order of writing, with a sentence about each."""


def _check_stroke(low: float, high: float) -> None:
    if low > high:
        raise ValueError("is reversed: give the lower limit first")
    if low > 0:
        raise ValueError("must be counted from mechanical zero, from below 0 to above 0")


# fmt: off
TOP = Section("", model.MachineFile, (
    Key("schema", one_of((model.SCHEMA_VERSION,), "this program reads no other version"),
        "Version of the format: 1.", required=True, attribute=None),
    Key("name", TEXT, "Name of the machine, for people."),
    Key("urdf", TEXT, "Folder, seen from this file, with `orthoglide.urdf` and "
        "`orthoglide.closures.toml`, which then state where the joints are."),
), tuple(TABLES))
GEOMETRY = Section("geometry_mm", Geometry, (
    Key("L", quantity(MM, 5), "Length of the long bars.", required=True),
    Key("d", quantity(MM, 1), "Length of the short links.", required=True),
    Key("r", _PLATFORM_RADIUS, "Distance from the TCP, or the platform's middle, to the legs' last "
        "revolutes. Required here or as `r_mm` of `[layout]`."),
    Key("stroke", list_of(_LENGTH, 2, check=_check_stroke),
        "Lower and upper limit of travel, from mechanical zero.", required=True),
))
DIAL = Section("dial_mm", model.Dial, (
    Key("resolution", quantity(MM, 5e-5, 10), "Step of the display."),
    Key("repeatability", quantity(MM, 1e-7, NOISE_LIMITS[1] / MM.si),
        "Standard deviation of one reading. If absent, that of the repeats or the usual one."),
    Key("placement", quantity(MM, 0, 100, closed=True), "Standard deviation of `gauge_mm`."),
))
INSTRUMENT = Section("instrument", model.Instrument, (
    Key("resolution", quantity(MM, 0, 10), "Step of the display: mm, or mrad for `incline`."),
    Key("repeatability", quantity(MM, 0, 10), "As of a dial, in the unit of `resolution`."),
))
DRIVE = Section("drive", model.MachineFile, (
    Key("screw_pitch_mm", quantity(MM, 0.1, 1000), "Lead of the drives' screws. If absent, "
        "errors within a turn of a screw are no candidates."),
))
CONTROLLER = Section("controller", model.Controller, (
    Key("zero_mm", _POINT, "What the controller shows at mechanical zero, by leg."),
    Key("sign", list_of(one_of((1, -1)), 3), "1 where the controller counts away from the origin, "
        "else -1, by leg."),
))
CLASS = Section("class", model.MachineFile, (
    Key("kind", one_of(MACHINE_CLASSES), "`laboratory`, of ground steel, or `belts` on extrusions. "
        "If absent, `belts` of a linear delta, else `laboratory`.",
        attribute="build"),
))
MEASURED = Section("measured", model.Measured, (
    Key("rods_mm", list_of(_POSITIVE_LENGTH, 2),
        "Length of the bars between their pivots, in the mean of all: `[272.1, 0.1]`."),
    Key("travel_of_100_mm", list_of(_POSITIVE_LENGTH, 2), "How far a carriage went at a command "
        "of 100 mm (of a shorter stroke in proportion), in the mean of all: `[100.2, 0.05]`.",
        attribute="travel"),
))
STIFFNESS = Section("stiffness", model.Stiffness, (
    Key("torsion_Nmm_per_rad", quantity(Unit("N mm/rad", 1e-3), 0, _MAX_STIFFNESS, closed=True),
        "Torsional stiffness of a leg, no longer modelled: a warning says from which value it "
        "matters.", attribute="torsion"),
    Key("bar_N_per_mm", quantity(Unit("N/mm", 1e3), 0, _MAX_STIFFNESS),
        "Axial stiffness of a bar. If absent, bars are rigid.", attribute="bar"),
))
KIND = Key("kind", one_of((Orthoglide.kind, LinearDelta.kind, FreeLegs.kind)),
           f"`{Orthoglide.kind}`, `{LinearDelta.kind}` or `{FreeLegs.kind}`.", required=True,
           attribute=None)
LAYOUT_R = Key("r_mm", _PLATFORM_RADIUS, "The `r` of `[geometry_mm]`, if it is not given there.",
               attribute=None)
_TOOL = Key("tool_mm", _POINT, "The tool's tip from the middle of the platform's joints.")
LAYOUTS = {
    Orthoglide.kind: Section("layout", Orthoglide, (KIND,)),
    LinearDelta.kind: Section("layout", LinearDelta, (
        KIND,
        Key("radius_mm", list_of(quantity(MM, 1), 3, single_allowed=True),
            "Horizontal distance of the towers' joints from the centre, one or by tower.",
            required=True),
        Key("angles_deg", list_of(_ANGLE, 3, single_allowed=True),
            "Directions of the towers from the centre, counter-clockwise from +x."),
        LAYOUT_R,
        _TOOL,
    )),
    FreeLegs.kind: Section("layout", FreeLegs, (KIND, LAYOUT_R, _TOOL), ("leg",)),
}
LEG = Section("layout.leg.NAME", FreeLeg, (
    Key("origin_mm", _POINT, "The carriage's joint at mechanical zero, with the tool at the "
        "origin.", required=True),
    Key("slide", _DIRECTION, "Direction of travel, away from the platform.", required=True),
    Key("link", _DIRECTION, "Direction of the short links.", required=True),
))
SURFACE_SLOPE = Key("surface_slope", quantity(RAD, 0, 1), "Slope of the reference surface of "
                    "kind `parallelism`, rad. If absent, the surface is taken as exact.")
SECTIONS_BY_ATTRIBUTE = {
    "dial": DIAL, "controller": CONTROLLER, "measured": MEASURED, "stiffness": STIFFNESS,
}  # by attribute
# fmt: on


def tolerances(catalogue: Catalogue) -> Section:
    """Return ``[tolerance]``: a key for each effect, and one for the reference surface."""
    keys = (Key(e.name, quantity(e.unit, 0, 1e6), e.sentence) for e in catalogue.values())
    return Section("tolerance", model.MachineFile, (*keys, SURFACE_SLOPE))


def parameter(unit: Unit) -> Section:
    """Return the inline table of a parameter whose effect is in a unit."""
    keys = (
        Key("value", quantity(unit, -1e9, 1e9, closed=True), "Estimated value.", required=True),
        Key("sigma", quantity(unit, 0, 1e9, closed=True), "Standard deviation.", required=True),
        Key("unit", one_of((unit.name,), "convert it"), "Unit of both.", required=True),
    )
    return Section("parameters", model.ParameterValue, keys)
