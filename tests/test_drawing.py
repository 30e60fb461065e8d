"""The drawing of a machine: the part that is wrong, its direction and size; also in the report."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from functools import cache
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import orthoglide as og
from orthoglide.effects import Catalogue
from orthoglide.machine_file import MachineFile
from orthoglide.parameters import Parameter
from orthoglide.pictures import dials, option
from orthoglide.scene import Dial, Mark, Posed, drawing
from orthoglide.scene.drawing import arrow, blank_paper
from tests.test_first_screen import PER, SCALES
from tests.test_layout import DELTA, freely


@cache
def machine(kind: str) -> og.Machine:
    if kind != "orthoglide":
        return og.Machine(MachineFile(geometry=DELTA if kind == "delta" else freely(DELTA)))
    return og.Machine(replace(og.Machine.nominal().spec, screw_pitch=0.02))


@cache
def posed(kind: str) -> Posed:
    return machine(kind).posed()


PARTS = {
    "joint_offset": "drive", "encoder_scale": "drive", "screw_error": "drive", "backlash": "drive",
    "drive_compliance": "drive", "axis_offset": "rail", "axis_tilt": "rail", "rail_tilt": "rail",
    "rail_bow": "rail", "rail_torsion": "carriage", "mount_tilt": "carriage",
    "leg_length": "bar", "bar_mismatch": "bar",
    "parallelogram_width": "link", "thermal_growth": "bar", "thermal_drift": "bar",
}  # fmt: skip
JOINTS = {
    "travel": "drive",
    "lateral": "rail",
    "turn": "carriage",
    "stretch": "bar",
    "width": "link",
}
AGAINST = {"rail_bow", "backlash"}  # u^2 - 1 between the ends; half of it behind a move outward


def part_of(catalogue: Catalogue, p: Parameter) -> str:
    """The part that an effect moves; of one that is not listed above, by its first joint."""
    joint = catalogue.motions[p][1][0].joint
    return PARTS.get(p.effect) or JOINTS[joint.partition("_")[0].rstrip("12")]


def shows(own: og.Machine, p: Parameter) -> bool:
    """Whether it moves anything: what hangs on a screw's pitch does not on a printer's belts."""
    return "pitch" not in own.catalogue.effect_of(p).needs or own.spec.screw_pitch is not None


def expected(catalogue: Catalogue, p: Parameter, posture: Posed) -> np.ndarray:
    """Direction in which the part moves, or about which it turns, for a positive value."""
    leg = posture.geometry.legs[catalogue.legs.index(p.leg)]
    across = dict(zip(catalogue.legs.across[catalogue.legs.index(p.leg)], leg.axes.T[1:],
                      strict=True))  # fmt: skip
    part = part_of(catalogue, p)
    if part == "bar":
        return (leg.carriage - leg.platform) / posture.geometry.L
    if part == "link":
        return leg.axes[:, 2]
    sign = -1.0 if p.effect in AGAINST else 1.0
    return sign * across.get(p.direction, leg.axes[:, 1] if p.direction == "b" else leg.axes[:, 0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("kind", "name"),
    [(k, p) for k in ("orthoglide", "delta") for p in machine(k).catalogue.parameters],
)
def test_every_effect_is_marked_on_its_part_with_direction_and_size(
    kind: str, name: Parameter, sign: float
) -> None:
    own = machine(kind)
    if not shows(own, name):
        pytest.skip("a printer's belts have no pitch")
    value = sign * 2 * own.tolerance(name)
    marks = option(own, "words", {name: value}).marks
    mark: Mark = marks[0]
    assert mark.part == part_of(own.catalogue, name)
    assert own.geometry.leg_names[mark.leg] == name.leg
    if name.effect not in ("drive_compliance", "screw_error"):  # which way hangs on the load
        along = float(mark.way @ expected(own.catalogue, name, posed(kind)))
        assert (along * sign if name.effect in PARTS else abs(along)) > 0.99
    found = re.search(r"([\d.]+) (mm|mrad|%|µm)", mark.label)
    assert found
    if name.effect not in ("thermal_drift", "screw_error"):
        size = float(found[1]) * SCALES[found[2]] * PER.get(name.effect, 1.0)
        assert size == pytest.approx(abs(value), rel=0.06)
    assert mark.both == ("approach" in own.catalogue.effect_of(name).needs)
    text = drawing(posed(kind), [option(own, "words", {name: value})])
    assert mark.label in html.unescape(text)


@pytest.mark.parametrize("kind", ["orthoglide", "delta", "free"])
def test_the_drawing_says_what_it_shows_and_keeps_on_its_paper(kind: str) -> None:
    own, base = machine(kind), machine(kind).catalogue["axis_tilt"].motions
    several = [option(own, f"cause {k} <&", {p: 3e-3}) for k, p in enumerate(base)]
    marked = (Dial("left", posed(kind).p, np.array([0.0, 1.0, 0.0])),)
    text = drawing(posed(kind), several, marked, title="A & B", first_shown=(1,))
    root = ET.fromstring(text)
    assert root.get("role") == "img"
    assert root.findtext("title") == "A & B"
    said = root.findtext("desc") or ""
    assert ("two rods to the effector" in said) == (kind == "delta")
    assert all(f"cause {k} <&" in said for k in range(len(several)))
    assert "Dials: left" in said
    hidden = [g.get("style") for g in root.iter("g") if "option" in (g.get("class") or "")]
    assert hidden == [None if k == 1 else "display:none" for k in range(len(several))]


def rooms(root: ET.Element) -> list[tuple[str, float, float, float, float]]:
    """Words and the box that each takes in a wide bold face."""
    found = []
    for element in root.iter("text"):
        text, x, y = element.text or "", float(element.get("x", 0)), float(element.get("y", 0))
        half = 8.5 * len(text) / 2
        found.append((text, x - half, y - 10, x + half, y + 3))
    return found


def apart(one: tuple[str, float, float, float, float], left: float, top: float, right: float,
          bottom: float) -> bool:  # fmt: skip
    _, l, t, r, b = one
    return r <= left or right <= l or b <= top or bottom <= t


@pytest.mark.parametrize(("kind", "sign"), [("orthoglide", 1.0), ("delta", -1.0), ("free", -1.0)])
def test_sizes_stand_on_the_paper_and_cover_no_name_and_no_dial(kind: str, sign: float) -> None:
    own, posture = machine(kind), posed(kind)
    stand = dials(posture, [og.protocol("sweep")]) if kind == "orthoglide" else ()
    for parameter in own.catalogue.parameters:
        if not shows(own, parameter):
            continue
        cause = option(own, "", {parameter: sign * 1.23 * own.tolerance(parameter)})
        root = ET.fromstring(drawing(posture, [cause], stand))
        _, _, width, height = map(float, (root.get("viewBox") or "").split())
        *names, size = sorted(rooms(root), key=lambda room: len(room[0]))
        circles = [
            [float(e.get(k, 0)) for k in ("cx", "cy", "r")]
            for g in root.iter("g") if g.get("class") == "dials" for e in g.iter("circle")
        ]  # fmt: skip
        assert len(circles) == len(stand)
        assert min(size[1:3]) >= 0, parameter
        assert size[3] <= width, parameter
        assert size[4] <= height, parameter
        assert all(apart(size, *name[1:]) for name in names), parameter
        assert all(apart(size, x - r, y - r, x + r, y + r) for x, y, r in circles), parameter


@pytest.mark.parametrize("kind", ["orthoglide", "delta", "free"])
def test_an_arrow_across_a_rail_is_seen_beside_it(kind: str) -> None:
    """The eye stood in line with one tower: its way outward lay upon it."""
    posture = posed(kind)
    across_paper, down, _ = blank_paper(posture).view
    for leg in posture.geometry.legs:
        (x, y), *across = ((across_paper @ a, down @ a) for a in leg.axes.T)
        for u, v in across:
            assert abs(x * v - y * u) / np.hypot(x, y) > 0.2


def test_an_arrow_that_is_seen_from_its_end_is_not_drawn() -> None:
    posture = posed("orthoglide")
    assert arrow(posture.p, posture.p, blank_paper(posture), "red") == ""
