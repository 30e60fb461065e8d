"""The test that confirms a cause, carried out on the independent machine.

Everything is measured as the words say: with a dial on a carriage, a square, or the bars in hand.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from orthoglide.effects import CATALOGUE
from orthoglide.effects.wording import confirm_words
from orthoglide.parameters import Parameter
from tests.rig import LEGS, Array, Rig

BASE = {"joint_offset.x": 0.8e-3, "joint_offset.z": -0.5e-3, "leg_length.y": 4e-5}


def bars(rig: Rig, leg: str, travel: float, side: float = 1.0) -> Array:
    """Ends of a leg's bars ``(bar, end, 3)``, millimetres, its own carriage moved."""
    rho = np.full(3, rig.L) + np.eye(3)[LEGS.index(leg)] * travel * 1e-3
    return np.asarray(rig.pose(rho, np.full(3, side)).lines[0, LEGS.index(leg)] * 1e3)


def carriage(rig: Rig, leg: str, travel: float, side: float = 1.0) -> Array:
    """Where the carriage of a leg stands ``(3,)``, millimetres; reached from smaller travel."""
    return np.asarray(bars(rig, leg, travel, side)[:, 0].mean(axis=0))


def axis(name: str) -> Array:
    return np.eye(3)[LEGS.index(name)]


def moved_100_mm_outward(rig: Rig, leg: str, across: str) -> float:
    return float((carriage(rig, leg, 20) - carriage(rig, leg, -80)) @ axis(across))


def middle_off_the_line(rig: Rig, leg: str, across: str) -> float:
    ends = (carriage(rig, leg, -100) + carriage(rig, leg, 60)) / 2
    return float((carriage(rig, leg, -20) - ends) @ axis(across))


def beyond_a_move_of_50_mm(rig: Rig, leg: str) -> float:
    """The mean over a whole turn of the screw, as a scale would be read."""
    return float((carriage(rig, leg, 20) - carriage(rig, leg, -30)) @ axis(leg)) - 50


def from_larger_travel(rig: Rig, leg: str) -> float:
    return float((carriage(rig, leg, 10, -1.0) - carriage(rig, leg, 10, 1.0)) @ axis(leg))


def wider_at_the_platform(rig: Rig, leg: str) -> float:
    one, other = bars(rig, leg, 0)
    return float(np.linalg.norm(one[1] - other[1]) - np.linalg.norm(one[0] - other[0]))


def hinge_about(rig: Rig, leg: str, about: str) -> float:
    """Milliradians by which the short link at the carriage is turned, right-handed."""
    one, other = bars(rig, leg, 0)
    link = (one[0] - other[0]) / np.linalg.norm(one[0] - other[0])
    square = axis(LEGS[(LEGS.index(leg) + 2) % 3])
    return float(np.cross(square, link) @ axis(about)) * 1e3


TOWARD = re.compile(r"expect (?:its middle )?([\d.]+) mm toward (−?)([xyz])")
MEASURED: dict[str, tuple[re.Pattern[str], Callable[..., float], tuple[str, str]]] = {
    "axis_tilt": (TOWARD, moved_100_mm_outward, ("", "−")),
    "rail_bow": (TOWARD, middle_off_the_line, ("", "−")),
    "encoder_scale": (
        re.compile(r"expect ([\d.]+) mm (more|less) than commanded for 50 mm of it"),
        beyond_a_move_of_50_mm,
        ("more", "less"),
    ),
    "backlash": (
        re.compile(r"expect it ([\d.]+) mm (farther out|farther in) when it comes from larger"),
        from_larger_travel, ("farther out", "farther in"),
    ),
    "parallelogram_width": (
        re.compile(r"expect it ([\d.]+) mm (wider|narrower) at the platform"),
        wider_at_the_platform, ("wider", "narrower"),
    ),
    "mount_tilt": (
        re.compile(r"expect the hinge ([\d.]+) mrad off about ([xyz])[^:]*, (right|left)-handed"),
        hinge_about, ("right", "left"),
    ),
}  # fmt: skip
"""By effect: what its words expect, how that is measured, and the words for either sign."""


SIZES = {
    "axis_tilt": 3e-3, "rail_bow": 0.3e-3, "encoder_scale": 4e-3, "backlash": 0.15e-3,
    "parallelogram_width": 2e-3, "mount_tilt": 15e-3,
}  # fmt: skip


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", [p for p in CATALOGUE.parameters if p.effect in SIZES])
def test_the_confirming_test_shows_what_its_words_expect(name: Parameter, sign: int) -> None:
    value, leg = sign * SIZES[name.effect], name.leg
    words = confirm_words(CATALOGUE.effect_of(name), name, value)
    rig = Rig(errors=BASE | {str(name): value})
    pattern, measure, signs = MEASURED[name.effect]
    found = pattern.search(words)
    assert found, words
    assert leg in words.partition(": expect")[0]
    across = [name.direction] if name.direction else []
    if pattern is TOWARD:
        said = signs.index(found[2]), found[3]
    elif name.effect == "mount_tilt":
        said = signs.index(found[3]), found[2]
        across = [LEGS[(LEGS.index(leg) + "ab".index(name.direction)) % 3]]
    else:
        said = signs.index(found[2]), ""
    assert said[1] == "".join(across)
    expected = float(found[1]) * (1 - 2 * said[0])
    shown = measure(rig, leg, *across)
    # A carriage whose stroke is shorter was asked to move so far; the size expected says for what.
    assert not re.search(r"\bmove (of )?\d+ mm", words)
    if measure is moved_100_mm_outward:
        assert words.endswith("for 100 mm of travel")
    assert np.sign(expected) == np.sign(shown), (words, shown)
    assert expected == pytest.approx(shown, rel=0.15), words
