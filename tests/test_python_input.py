"""What Python passes in and cannot be meant is refused, with what would be right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide.planning.owning import sheet_of

WORN = og.Machine.nominal().with_parameters({"joint_offset.x": 6e-4, "leg_length.y": 5e-5})
DIALS = og.simulate(WORN, "standard", noise=5e-6, seed=1)
POINTS = og.simulate_tcp(WORN, 20, seed=1)


def cases(*given: tuple[str, Callable[[], Any], str]) -> pytest.MarkDecorator:
    """By their name: what is called, and the words with which it is refused."""
    calls = [(call, words) for _, call, words in given]
    return pytest.mark.parametrize(("call", "words"), calls, ids=[name for name, *_ in given])


def refused(call: Callable[[], Any], words: str) -> None:
    with pytest.raises(og.InputError, match=words):
        call()


def fit(given: Any = DIALS, **options: Any) -> og.Estimate:
    return og.identify(given, **options)


@cases(
    ("method", lambda: fit(method="reduced"), "no method 'reduced': .* auto, nlp, nested"),
    ("weighting", lambda: fit(weighting="deviation"), "one of readings, deviations"),
    ("frame", lambda: fit(frame="foo"), "no frame 'foo': it is one of none, translation, rigid"),
    ("frame of points", lambda: fit(POINTS, frame="foo"), "one of none, translation, rigid"),
    ("frame of a loop", lambda: og.close_loop(DIALS, frame="foo"), "one of none"),  # type: ignore[arg-type]
    ("bounds", lambda: fit(bounds={"joint_ofset": 1e-5}), "no free parameter 'joint_ofset': .*_l"),
    ("free", lambda: fit(free="joint_offset"), r"free is a list of names: give \['joint_offset'\]"),
    ("own", lambda: fit(own="joint_offset"), "own is a list of names"),
    ("effects", lambda: og.smallest_effects(WORN, DIALS, names=["foo"]), "no effect 'foo': the"),
    ("an effect", lambda: og.smallest_effects(WORN, DIALS, names="axis_tilt"), "names is a list"),
    ("designed", lambda: og.design(WORN, free="leg_length"), "free is a list of names"),
    ("a count", lambda: og.design(WORN, count=12.5), "ask for 12, not 12.5"),  # type: ignore[arg-type]
    ("a method for dials", lambda: fit([DIALS, POINTS], method="reduction"), "predicts dials only"),
)
def test_misspelt_options(call: Callable[[], Any], words: str) -> None:
    refused(call, words)


def test_bounds_of_what_is_free_hold() -> None:
    found = fit(bounds={"joint_offset": 1e-5, "leg_length.x": 1e-3})
    assert max(abs(found.values[f"joint_offset.{leg}"]) for leg in "xyz") < 1.1e-5


def test_smallest_effects_of_one_parameter() -> None:
    found = og.smallest_effects(WORN, DIALS, names=["axis_tilt.y.z"])
    assert {s.effect for s in found.smallest} == {"axis_tilt"}
    assert {s.name for s in found.smallest if s.elementary} == {"axis_tilt.y.z"}


def test_figures_are_svg(tmp_path: Path) -> None:
    refused(lambda: fit().plot().save(tmp_path / "a.png"), "ends in .svg")
    assert not list(tmp_path.iterdir())


def mounted(**changed: Any) -> og.Campaign:
    """The dials with something of their mountings changed."""
    return replace(DIALS, setups=tuple(replace(s, **changed) for s in DIALS.setups))


def with_one(name: str, value: Any, given: Any = DIALS) -> Any:
    """Readings with one entry of an array changed, the fourth."""
    array = getattr(given, name).copy()
    array[3] = value
    return replace(given, **{name: array})


def tool(kind: str = "ballbar") -> og.ToolCampaign:
    found = sheet_of(og.Machine.nominal(), kind)
    assert isinstance(found, og.ToolCampaign)
    return found


@cases(
    ("gauge in mm", lambda: mounted(gauge=155.0), "the gauge at 155000 mm is off the leg"),
    ("sign", lambda: mounted(sign=0), "its sign is 1 or -1"),
    ("bar", lambda: mounted(bar=3), "its bar 0, 1 or 2"),
    ("leg", lambda: mounted(leg=3), "legs and axes are 0, 1 or 2"),
    ("a leg's name", lambda: mounted(leg="x"), "legs and axes are 0, 1 or 2"),
    ("names", lambda: mounted(name="a"), "two setups are called 'a'"),
    ("setup", lambda: with_one("setup", 9), "setup must index one of the 6 setups"),
    ("half a setup", lambda: replace(DIALS, setup=DIALS.setup + 0.5), "row 0 .* not a whole num"),
    ("approach", lambda: with_one("approach", 2.0), "approach is .1 or -1"),
    ("no command", lambda: with_one("command", np.nan), "command of row 3 .* not a finite number"),
    ("commands in mm", lambda: replace(DIALS, command=DIALS.command * 1e3), "outside its stroke"),
    ("not read", lambda: og.protocol("standard"), "no readings yet.*metres and radians"),
    ("one not read", lambda: with_one("reading", np.nan), "row 3 .*reading_mm is empty"),
    ("infinite", lambda: with_one("reading", np.inf), "reading of row 3 .* is inf"),
    ("readings in mm", lambda: DIALS.with_readings(DIALS.reading * 1e3), "give millimetres"),
    ("nothing", lambda: DIALS.subset([]), "standard: has no readings"),
    ("sigma in mm", lambda: with_one("sigma", 5e-3), "row 3 .*sigma is 0.005: .*in metres from"),
    ("negative sigma", lambda: with_one("sigma", -5e-6), "row 3 .*sigma is -5e-06"),
    ("no campaign", lambda: None, "a NoneType holds no readings"),
    ("an array", lambda: np.zeros(3), "a float64 holds no readings"),
    ("points in mm", lambda: replace(POINTS, p=POINTS.p * 1e3), "give a thousandth of each"),
    ("points' sigma", lambda: with_one("sigma", 0.01, POINTS), "points, row 3 .*sigma is 0.01"),
    ("points' shape", lambda: replace(POINTS, p=POINTS.p[:10]), r"command must have shape \(10, 3"),
    ("tool, not read", lambda: with_one("reading", np.nan, tool()), "row 3 .*the reading is empty"),
    ("tool's sigma", lambda: with_one("sigma", 0.005, tool()), "row 3 .*sigma is 0.005"),
    ("level's sigma", lambda: with_one("sigma", 0.2, tool("incline")), "row 3 .*1e-09 to 0.1"),
    ("tool's shape", lambda: replace(tool(), sigma=np.zeros(2)), "sigma must have shape"),
    ("tool's kind", lambda: og.ToolSetup("a", "ruler"), "no kind of reading 'ruler'"),  # type: ignore[arg-type]
)  # fmt: skip
def test_readings_that_cannot_be(call: Callable[[], Any], words: str) -> None:
    """As files are checked; of what has no unit, already where it is put together."""
    refused(lambda: fit(call()), words)


@cases(
    ("readings", lambda: og.close_loop(with_one("reading", np.nan)), "is empty"),
    ("hold-out", lambda: og.close_loop(DIALS, holdout=mounted(gauge=155.0)), "off the leg"),
    ("points", lambda: og.close_loop(DIALS, tcp=replace(POINTS, p=POINTS.p * 1e3)), "thousandth"),
)
def test_the_loop_checks_all_that_it_is_given(call: Callable[[], Any], words: str) -> None:
    refused(call, words)


def test_lists_do_for_arrays() -> None:
    points = og.TcpPoints(
        POINTS.command.tolist(),
        POINTS.p.tolist(),
        [np.nan] * 20,
        [[0] * 3] * 20,
        list(range(20)),  # type: ignore[arg-type]
    )
    assert fit(points).values == fit(POINTS).values
