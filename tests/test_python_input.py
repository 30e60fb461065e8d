"""What Python passes in and cannot be meant is refused, with what would be right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from inspect import isfunction, signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide.checking import read_states
from orthoglide.effects import CATALOGUE
from orthoglide.fit import points_of
from orthoglide.observations import campaign_text
from orthoglide.parameters import MEMBERS
from orthoglide.planning.sheets import instrument_sheet
from orthoglide.report import result_text

WORN = og.Machine.nominal().with_parameters({"joint_offset.x": 6e-4, "leg_length.y": 5e-5})
DIALS = og.simulate(WORN, "standard", noise=5e-6, seed=1)
POINTS = og.simulate_tcp(WORN, 20, seed=1)
AT, IN_MM = POINTS.points(), POINTS.with_readings(POINTS.reading * 1e3)
ZERO = WORN.geometry.zero
FRAME: Any = {"leg": ["x"], "reading_mm": [0.1]}


def cases(*given: tuple[str, Callable[[], Any], str]) -> pytest.MarkDecorator:
    """By their name: what is called, and the words with which it is refused."""
    calls = [(call, words) for _, call, words in given]
    return pytest.mark.parametrize(("call", "words"), calls, ids=[name for name, *_ in given])


def refused(call: Callable[[], Any], words: str) -> None:
    with pytest.raises(og.InputError, match=words):
        call()


@cache
def closed() -> og.Verdict:
    return og.close_loop(DIALS)


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
    ("free of a design", lambda: og.design(WORN, 3), "free is a list of names, such as"),  # type: ignore[arg-type]
    ("free of nothing", lambda: og.design(WORN, [None]), r"not \[None\]"),  # type: ignore[list-item]
    (
        "what was fitted",
        lambda: og.next_measurements(DIALS),
        "must be an Estimate",
    ),  # type: ignore[arg-type]
    ("effects", lambda: og.smallest_effects(WORN, DIALS, names=["foo"]), "no effect 'foo': the"),
    ("an effect", lambda: og.smallest_effects(WORN, DIALS, names="axis_tilt"), "names is a list"),
    ("designed", lambda: og.design(WORN, free="leg_length"), "free is a list of names"),
    ("a word for a count", lambda: og.design(WORN, count="12"), "'12' readings cannot be chosen"),  # type: ignore[arg-type]
    ("an instrument", lambda: og.tool_sheets(WORN, "plate"), "kinds is a list of names: give"),
    ("compared", lambda: og.compare_effects(WORN, "rail_bow"), "names is a list of names: give"),
    ("a count", lambda: og.design(WORN, count=12.5), r"12\.5 readings cannot be chosen: give"),  # type: ignore[arg-type]
    ("a method for dials", lambda: fit([DIALS, POINTS], method="reduction"), "predicts dials only"),
    (
        "a condition",
        lambda: WORN.forward(ZERO, aproach=1),
        "no condition 'aproach': .* approach, t",
    ),
    ("a condition back", lambda: WORN.inverse([0, 0, 0], aproach=1), "no condition 'aproach'"),
    ("an interval", lambda: fit().interval("joint_ofset.x"), "no identified parameter 'joint_ofse"),
    ("no effect", lambda: og.close_loop(DIALS, effects=3), "each an og.Effect"),  # type: ignore[arg-type]
    ("an effect's name", lambda: og.close_loop(DIALS, effects=["axis_tilt"]), "each an og.Effect"),
    ("effects' names", lambda: og.close_loop(DIALS, effects="axis_tilt"), "each an og.Effect"),
    ("a level", lambda: og.smallest_effects(WORN, DIALS, level=2), "level is a probability"),
)
def test_misspelt_options(call: Callable[[], Any], words: str) -> None:
    refused(call, words)


@cases(
    ("commands", lambda: WORN.forward(["a", "b", "c"]), "rho must be numbers"),
    ("ragged commands", lambda: WORN.forward([[1, 2, 3], [1]]), "rho must be numbers"),
    ("a goal", lambda: WORN.inverse("abc"), "p must be numbers"),
    ("no parameters", lambda: WORN.with_parameters(None), "{NAME: NUMBER}, not a NoneType"),
    ("pairs", lambda: WORN.with_parameters([("joint_offset.x", 0.0)]), "must be numbers by name"),
    ("only", lambda: WORN.with_only({"joint_offset.x": "1"}), "joint_offset.x must be a number"),
    ("sigmas", lambda: WORN.with_parameters({}, [1.0]), "deviations must be numbers"),
    ("two radii", lambda: og.LinearDelta(radius=(0.1, 0.1)), "radius must be three finite numbers"),
    ("a tool", lambda: og.LinearDelta(radius=0.1, tool="a"), "tool must be numbers"),
    ("a leg", lambda: og.FreeLeg("one", (0, 0), (1, 0, 0), (0, 1, 0)), "leg one: origin must be t"),
    ("common", lambda: og.FreeLeg("common", (0, 0, 0), (1, 0, 0), (0, 1, 0)), "another name"),
    ("stroke", lambda: og.Geometry(stroke=(-0.1, 0.0, 0.1)), "the stroke's two limits"),
    ("a length", lambda: og.Geometry(L="0.3"), "L must be a positive length, not '0.3'"),
    ("protocol", lambda: og.protocol("sweep", WORN), "a Geometry, as machine.geometry is"),
    ("noise", lambda: fit(noise="0.005"), "standard deviation in metres, .* not '0.005'"),
    ("path", lambda: og.compensate(WORN, [["a", 0, 0]]), "a path must be numbers"),
    ("no path", lambda: og.compensate(WORN, np.zeros((0, 3))), "shape"),
    ("a point", lambda: og.compensate(WORN, np.zeros(3)), "shape"),
    ("two columns", lambda: og.compensate(WORN, np.zeros((2, 2))), "shape"),
    ("no number", lambda: og.compensate(WORN, [[0, 0, 0], [0, np.nan, 0]]), "row 2"),
    ("load", lambda: og.compensate(WORN, [[0, 0, 0]], load="a"), "load must be numbers"),
    ("two starts", lambda: og.compensate(WORN, [[0, 0, 0]], start=np.zeros((2, 3))), "start must"),
    ("start", lambda: og.compensate(WORN, [[0, 0, 0]], start="a"), "start must be numbers"),
    ("no machine", lambda: og.compensate(3, [[0, 0, 0]]), "must be a Machine, the path of its"),
    ("no seed", lambda: og.simulate(WORN, seed=None), "seed must be 0 or more and whole, not None"),
    ("half a seed", lambda: og.close_loop(DIALS, seed=1.5), "seed must be 0 or more and whole"),
    ("negative seed", lambda: og.close_loop(DIALS, seed=-1), "seed must be 0 or more"),
    ("sheets", lambda: og.simulate(WORN, [DIALS]), "must be one table of readings, .* not a list"),
    ("no points", lambda: og.simulate_tcp(WORN, -1), "count must be 1 or more"),
    ("no file", lambda: og.Machine.load(None), "the name of a file or folder, not a NoneType"),
    ("a handle", lambda: og.read_campaign(3), "the name of a file or folder, not a int"),
    ("no place", lambda: WORN.save(None), "the name of a file or folder, not a NoneType"),
    ("no folder", lambda: closed().report(None), "the name of a file or folder, not a NoneType"),
)  # fmt: skip
def test_what_is_of_another_type(call: Callable[[], Any], words: str) -> None:
    refused(call, words)


FUNCTIONS = [n for n in og.__all__ if isfunction(getattr(og, n)) and n != "once"]  # used later


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_refuses_what_is_no_argument(name: str) -> None:
    """What nothing can be done with, in the place of all that must be given, or of the first."""
    every = signature(getattr(og, name)).parameters.values()
    needed = [p for p in every if p.default is p.empty] or list(every)[:1]
    refused(
        lambda: getattr(og, name)(**{p.name: object() for p in needed}),
        "object|numbers|with readings",
    )


@cases(
    ("a sheet", lambda: og.smallest_effects(WORN, None), "campaign must be Readings .*not None"),
    ("no sheet", lambda: og.smallest_effects(WORN, []), "there are no readings"),
    ("a number's name", lambda: WORN.with_parameters({1: 2}), r"Mapping\[str, float\], not {1: 2}"),
    ("sigmas by number", lambda: WORN.with_parameters({}, {1: 2}), "given of 1"),
    (
        "a kind",
        lambda: og.protocol(np.zeros(3)),
        "kind must be one of standard, sweep, .*, not array",
    ),
    ("a tolerance", lambda: WORN.tolerance(None), "name must be str, not None"),
    ("readings", lambda: WORN.readings(None), "given must be Readings, not None"),
    ("a switch", lambda: WORN.save("x.toml", overwrite=np.zeros(3)), "overwrite must be bool"),
    ("a gauge", lambda: og.Setup("s", 0, 1, gauge=None), "gauge must be float, not None"),
    ("labels", lambda: replace(DIALS, posture=5), "posture must be tuple"),
    ("rows", lambda: DIALS.subset([[0, 1], [2, 3]]), "rows are indices, or 54 booleans"),
    ("reading", lambda: DIALS.with_readings(1.0), "setup must have shape"),
    ("a point", lambda: og.Readings.from_points(ZERO, 1.0), r"p must have shape \(m, 3\)"),
    ("a layout", lambda: og.Geometry(layout=None), "layout must be layouts.Layout, not None"),
    ("used later", lambda: og.MachineFile(dial=3), "dial must be Dial, not 3"),
    ("a value later", lambda: og.MachineFile(parameters={"a": 1.0}), "parameters must be Mapping"),
)
def test_arguments_are_what_their_annotations_say(call: Callable[[], Any], words: str) -> None:
    refused(call, words)


def test_what_a_user_passes_in_may_fail_by_itself() -> None:
    """An error of a function that somebody gave is theirs, and no argument is to blame."""
    with pytest.raises(ZeroDivisionError):
        DIALS.which(lambda setup: 1 / 0)
    with pytest.raises(TypeError, match="unexpected keyword"):
        og.protocol("standard", machine=WORN)  # type: ignore[call-arg]


@cases(
    (
        "identified",
        lambda: fit(FRAME),
        "a campaign, which og.Campaign.from_frame makes of a data frame",
    ),
    ("closed", lambda: og.close_loop(FRAME), "og.Campaign.from_frame"),
    ("checked", lambda: og.check(DIALS, FRAME), "og.Campaign.from_frame"),
    ("rows", lambda: og.Campaign.from_frame([{"leg": "x"}]), "a list: give a data frame, or a map"),
    ("none", lambda: og.Campaign.from_frame(None), "a NoneType: give a data frame"),
    ("a path", lambda: og.Campaign.from_frame("a.csv"), "a str: give a data frame"),
    ("points", lambda: og.Campaign.from_frame(POINTS), "a Readings: give a data frame"),
    ("a cell", lambda: og.Campaign.from_frame({"leg": 1}), "each column must be a list"),
)
def test_frames(call: Callable[[], Any], words: str) -> None:
    refused(call, words)


def test_a_column_twice_is_said_as_of_a_file() -> None:
    pd = pytest.importorskip("pandas")
    df = DIALS.to_frame()
    twice = pd.concat([df, df[["leg"]]], axis=1)
    refused(lambda: og.Campaign.from_frame(twice), "names column 'leg' twice: remove one")
    refused(lambda: fit(df), "a campaign, which og.Campaign.from_frame makes")


def test_one_effect_is_a_list_of_one() -> None:
    mine = replace(WORN.catalogue["axis_tilt"], name="mine")
    known = WORN.with_effects(mine)  # type: ignore[arg-type]
    assert list(known.catalogue) == [*WORN.catalogue, "mine"]


def test_words_of_structured_members_name_no_leg() -> None:
    every = {p for e in CATALOGUE for p in CATALOGUE.structured_members(e, ("any",))}
    assert {p.member.rpartition(".")[2] for p in every} == set(MEMBERS)


def test_paths_do_for_machines_and_points(tmp_path: Path) -> None:
    file, points = tmp_path / "machine.toml", tmp_path / "points.tcp.csv"
    WORN.save(file)
    points.write_text(campaign_text(POINTS, WORN.spec), encoding="utf-8")
    path = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]]
    assert np.array_equal(og.compensate(file, path).rho, og.compensate(WORN, path).rho)
    assert np.array_equal(og.simulate(str(file), seed=3).reading, og.simulate(WORN, seed=3).reading)
    judged, same = (points_of(p, WORN) for p in (points, POINTS))
    assert same is POINTS
    assert np.allclose(judged.points().p, POINTS.points().p, atol=1e-9)


def test_states_are_read_from_results_too(tmp_path: Path) -> None:
    verdict = closed()
    (tmp_path / "result.json").write_text(result_text(verdict), encoding="utf-8")
    for state in (tmp_path, tmp_path / "result.json", verdict.request):
        old, new = read_states(state, DIALS)
        assert old.machine is new.machine
        assert old.machine.geometry == WORN.geometry
        assert np.array_equal(old.given[0].reading, DIALS.reading)
        assert new.given == (DIALS,)
        assert old.noise is None
    old, _ = read_states(replace(verdict.request, noise=2e-5), DIALS)
    assert old.noise == 2e-5
    assert og.check(verdict, replace(DIALS, name="again")).old == ("standard",)
    other = og.Machine(replace(WORN.spec, geometry=og.Geometry(L=0.32)))
    away = replace(verdict, request=replace(verdict.request, machine=other)).request
    refused(lambda: read_states(verdict.request, away), "have different dimensions")


def test_what_holds_no_readings_is_not_written(tmp_path: Path) -> None:
    for given in ("abc", None, [], DIALS.subset(np.zeros(len(DIALS), dtype=bool))):
        refused(lambda given=given: og.write_campaign(given, tmp_path / "x.csv"), "with readings")


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


def tool(kind: str = "ballbar") -> og.Readings:
    sheet = instrument_sheet(og.Machine.nominal(), kind)
    return sheet.with_readings(np.nan_to_num(sheet.reading))


def points(**changed: Any) -> og.Readings:
    """Points of the tool with something of them changed."""
    return og.Readings.from_points(**{"command": AT.command, "p": AT.p, **changed})


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
    ("no campaign", lambda: None, "not a NoneType"),
    ("an array", lambda: np.zeros(3), "not a float64"),
    ("points in mm", lambda: IN_MM, "give a thousandth of each"),
    ("points' sigma", lambda: with_one("sigma", 0.01, POINTS), "points, row 3 .*sigma is 0.01"),
    ("points' number", lambda: points(p=AT.p[:10]), "as many commands as points, 10"),
    ("points' shape", lambda: points(p=AT.p[:, :2]), r"p must have shape \(m, 3\)"),
    ("infinite point", lambda: points(p=AT.p * np.inf), "reading of row 0 .* is -?inf"),
    ("no point", lambda: points(p=AT.p * np.nan), "row 0 .* has no coordinate"),
    ("tool, not read", lambda: with_one("reading", np.nan, tool()), "row 3 .*reading_mm is empty"),
    ("tool's sigma", lambda: with_one("sigma", 0.005, tool()), "row 3 .*sigma is 0.005"),
    ("level's sigma", lambda: with_one("sigma", 0.2, tool("incline")), "row 3 .*1e-09 to 0.1"),
    ("tool's shape", lambda: replace(tool(), sigma=np.zeros(2)), "sigma must have shape"),
    ("tool's kind", lambda: og.Setup("a", kind="ruler"), "no kind of reading 'ruler'"),
    ("kind alone", lambda: og.ToolSetup("a", "plate"), "pass it as kind='plate'"),  # type: ignore[arg-type]
)  # fmt: skip
def test_readings_that_cannot_be(call: Callable[[], Any], words: str) -> None:
    """As files are checked; of what has no unit, already where it is put together."""
    refused(lambda: fit(call()), words)


@cases(
    ("readings", lambda: og.close_loop(with_one("reading", np.nan)), "is empty"),
    ("hold-out", lambda: og.close_loop(DIALS, holdout=mounted(gauge=155.0)), "off the leg"),
    ("points", lambda: og.close_loop(DIALS, tcp=IN_MM), "thousandth"),
    ("no points", lambda: og.close_loop(DIALS, tcp=DIALS), "a Readings holds no TCP points: give"),
    ("a list of points", lambda: og.close_loop(DIALS, tcp=[POINTS]), "a list holds no TCP points"),
    ("a missing file", lambda: og.close_loop(DIALS, tcp="no.tcp.csv"), "no.tcp.csv: there is no s"),
)
def test_the_loop_checks_all_that_it_is_given(call: Callable[[], Any], words: str) -> None:
    refused(call, words)
