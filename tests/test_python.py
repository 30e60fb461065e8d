"""The package as Python sees it: what is exported, travels, is shown, and runs on one thread."""

from __future__ import annotations

import ast
import copy
import importlib
import pickle
import pkgutil
import sys
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import threadpoolctl

import orthoglide as og
from orthoglide.closing import RunOutcome, build_result
from orthoglide.control import commands_text
from orthoglide.layout import LinearDelta
from orthoglide.observations import campaign_text
from orthoglide.planning.suggestions import Suggestion
from orthoglide.threads import on_one_thread
from tests.studied import studied
from tests.test_cli import done

RIG = Path(__file__).parent / "data" / "rig"
ERRORS = {"joint_offset.x": 1e-3, "axis_tilt.y.z": 2e-3, "backlash.z": 5e-5}
RHO = og.Geometry().L + np.random.default_rng(0).uniform(-0.1, 0.06, (5, 3))

COPIES = {"pickle": lambda value: pickle.loads(pickle.dumps(value)), "deepcopy": copy.deepcopy}
copied = pytest.mark.parametrize("travel", list(COPIES.values()), ids=list(COPIES))
Travel = Callable[[Any], Any]


@pytest.fixture(scope="module")
def campaign(machine: og.Machine) -> og.Campaign:
    return og.read_campaign(RIG / "rig-2.csv", machine.spec)


@pytest.fixture(scope="module")
def estimate(campaign: og.Campaign, machine: og.Machine) -> og.Estimate:
    return og.identify(campaign, machine)


@pytest.fixture(scope="module")
def closed(campaign: og.Campaign, machine: og.Machine) -> RunOutcome:
    return studied(campaign, machine)


@pytest.fixture(scope="module")
def verdict(closed: RunOutcome) -> og.Verdict:
    return build_result(closed, og.Verdict)


def test_no_public_name_is_a_room() -> None:
    """Else importing the room would put itself in the name's place."""
    assert not set(og.__all__) & {m.name for m in pkgutil.iter_modules(og.__path__)}


def test_type_checkers_see_what_is_exported() -> None:
    tree = ast.parse(Path(og.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    typed = [
        (f"{node.module}", alias.asname)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module.startswith("orthoglide.")  # type: ignore[union-attr]
        for alias in node.names
    ]
    assert sorted(name for _, name in typed) == og.__all__  # type: ignore[type-var]
    for module, name in typed:
        assert getattr(importlib.import_module(module), str(name)) is getattr(og, str(name))


ROOMS = [m.name for m in pkgutil.iter_modules(og.__path__) if m.ispkg]


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_say_what_is_public(room: str) -> None:
    """What a room shows is what its own file imports, from itself (and a parameter's name)."""
    module = importlib.import_module(f"orthoglide.{room}")
    assert (module.__doc__ or "").strip()
    for node in ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and room not in ("cli", "report"):  # which do more
            own = (f"orthoglide.{room}.", "orthoglide.parameters")
            assert str(node.module).startswith(own), node.module
            # A plain import is private to type checkers.
            assert all(alias.asname == alias.name for alias in node.names), node.module


@pytest.mark.parametrize("exact", [False, True])
def test_simulate_is_the_command(exact: bool, tmp_path: Path) -> None:
    machine = og.Machine.nominal().with_parameters(ERRORS)
    machine.save(tmp_path / "m.toml")
    options = ("--kind", "sweep", *(("--exact",) if exact else ("--seed", "5")))
    done("simulate", "--machine", tmp_path / "m.toml", "--out", tmp_path / "a.csv", *options)
    sheet = og.protocol("sweep", machine.geometry)
    filled = og.simulate(machine, sheet, seed=5, exact=exact)
    assert campaign_text(filled) == (tmp_path / "a.csv").read_text()
    assert campaign_text(og.simulate(machine, "sweep", seed=5, exact=exact)) == campaign_text(
        filled
    )


def test_what_is_shown_of_a_machine() -> None:
    assert repr(og.Machine.nominal()) == "<Machine 'Orthoglide, nominal': no errors>"
    many = og.Machine.nominal().with_parameters({"leg_length.common": 1e-4, **ERRORS})
    assert repr(many).endswith("leg_length.x, leg_length.y, leg_length.z and 3 more>")


def test_the_frame_of_an_estimate(estimate: og.Estimate) -> None:
    frame = estimate.to_frame()
    assert list(frame.index) == list(estimate.names)
    for name, row in frame.iterrows():
        low, high = estimate.interval(name)
        expected = np.array([estimate.values[name], estimate.sigmas[name], low, high]) * 1e3
        shown = [row["value"], row["sigma"], row["lower"], row["upper"]]
        assert np.allclose(np.array(shown, float), expected, rtol=1e-12)
        assert row["unit"] == "mm"
        assert row["tolerance"] == pytest.approx(estimate.problem.machine.tolerance(name) * 1e3)


def test_what_is_shown_of_a_campaign(campaign: og.Campaign) -> None:
    assert repr(campaign) == "<Readings 'rig-2': 54 readings in 6 setups>"
    assert repr(og.protocol("standard")).endswith(
        "54 readings in 6 setups, 54 of them to be taken>"
    )
    page = campaign._repr_html_()
    assert page.count("<tr>") == 22
    assert "<td>...</td>" in page
    points = og.read_tcp(RIG / "rig-2.tcp.csv")
    assert repr(points) == "<Readings 'rig-2.tcp': 180 readings in 1 setup (tcp)>"


def test_what_a_verdict_holds_is_shown_in_a_few_lines(
    verdict: og.Verdict, closed: RunOutcome
) -> None:
    """Its causes alone were 70 000 characters, with the catalogue and every array in them."""
    assert repr(verdict.effects[0]).startswith(
        "<Cause axis_tilt.y.z: the path of the y carriage is out of square toward z by 2.4 mrad"
    )
    assert repr(verdict.effects[0].chosen).startswith("<axis_tilt.y.z, probability 0.")
    catalogue = verdict.machine.catalogue
    assert repr(catalogue["backlash"]).startswith("<Effect backlash: ")
    for held in (
        verdict.effects, verdict.located, verdict.changed, verdict.budget[0],
        verdict.readings, verdict.workspace, verdict.picture, catalogue,
        verdict.machine.posterior, closed.effects, closed.posterior, closed.before.problem,
        closed.after.nuisance,
    ):  # fmt: skip
        assert len(repr(held)) < 600


def test_frames_say_what_they_need(estimate: og.Estimate, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(og.InputError, match="pip install pandas"):
        estimate.to_frame()
    assert "<table>" in estimate._repr_html_()


@copied
def test_machines_that_share_a_model_still_share_it(travel: Travel) -> None:
    one = og.Machine.nominal()
    one.forward(RHO)
    two = one.with_parameters(ERRORS)
    assert two.model is one.model
    first, second = travel((one, two))
    assert second.model is first.model


@copied
def test_an_estimate_travels(travel: Travel, estimate: og.Estimate) -> None:
    arrived = travel(estimate)
    assert arrived.values == estimate.values
    assert arrived.sigmas == estimate.sigmas
    assert str(arrived) == str(estimate)
    assert np.array_equal(arrived.residuals, estimate.residuals)
    assert np.array_equal(arrived.machine.forward(RHO), estimate.machine.forward(RHO))


@pytest.mark.parametrize(
    "method", ["forward", "jacobian", "pose", "bar_tensions", "close", "posed"]
)
def test_commands_in_millimetres_are_refused(method: str) -> None:
    with pytest.raises(og.InputError, match="in metres, not millimetres"):
        getattr(og.Machine.nominal(), method)([320, 310, 300])


def test_millimetres_of_a_delta_are_refused() -> None:
    """Its carriages go up together: ten metres were as good as ten millimetres."""
    delta = og.Geometry(0.27, 0.05, 0.032, (-0.15, 0.3), LinearDelta((0.14,) * 3))
    with pytest.raises(og.InputError, match="in metres, not millimetres"):
        og.Machine.of(delta).forward([10, 10, 10])
    for wrong in ({"L": 310.25}, {"d": 80.0}, {"r": 31.0}):
        with pytest.raises(og.InputError, match="in metres, not millimetres"):
            og.Geometry(**wrong)


def test_points_in_millimetres_are_said_to_be_far() -> None:
    told = "give metres in Python, millimetres on the command line"
    with pytest.raises(og.UnreachableError, match=f"for a point 36 m away: {told}"):
        og.Machine.nominal().inverse([-12, 24, 24])
    with pytest.raises(
        og.UnreachableError, match=f"^row 1 .* too short for a point 36 m away: {told}"
    ):
        og.compensate(og.Machine.nominal(), [[-12, 24, 24]])


def test_types_are_shipped(tmp_path: Path) -> None:
    """Where the build tool is at hand, in the wheel itself."""
    root = Path(og.__file__).parent
    assert (root / "py.typed").is_file()
    build = pytest.importorskip("hatchling.builders.wheel")
    (wheel,) = build.WheelBuilder(str(root.parent)).build(directory=str(tmp_path))
    assert "orthoglide/py.typed" in zipfile.ZipFile(wheel).namelist()


def test_verdicts_and_estimates_plot_themselves(
    verdict: og.Verdict, closed: RunOutcome, tmp_path: Path
) -> None:
    drawing = verdict.plot("workspace")
    assert drawing._repr_svg_().startswith("<?xml")
    drawing.save(tmp_path / "figure.svg")
    assert (tmp_path / "figure.svg").read_text(encoding="utf-8") == drawing.svg
    with pytest.raises(og.InputError, match=r"no figure 'all': it is one of residuals, readings"):
        verdict.plot("all")
    estimate = closed.before
    told = ET.fromstring(estimate.plot().svg)
    texts = {"".join(e.itertext()).strip() for e in told.iter("{http://www.w3.org/2000/svg}text")}
    assert "reading less prediction, mm" in texts
    assert estimate.plot().svg == estimate.plot("residuals").svg != estimate.plot("readings").svg
    with pytest.raises(og.InputError, match=r"one of residuals, readings"):
        estimate.plot("workspace")


def test_what_is_shown_of_commands_and_numbers(campaign: og.Campaign) -> None:
    worn = og.Machine.nominal().with_parameters(ERRORS, dict.fromkeys(ERRORS, 1e-5))
    found = og.compensate(worn, [[0.0, 0.0, 0.0], [0.01, 0.005, 0.0]])
    frame = found.to_frame()
    assert frame[["rho_x_mm", "rho_y_mm", "rho_z_mm"]].to_numpy() == pytest.approx(found.rho * 1e3)
    assert frame["expected_mm"].to_numpy() == pytest.approx(found.accuracy * 1e3)
    assert list(frame) == commands_text(found).splitlines()[0].split(",")
    assert repr(found).startswith("<Compensation of 2 points: 0.")
    numbers = og.controller_numbers(worn)
    drives = numbers.to_frame()
    assert list(drives.index) == ["x", "y", "z"]
    assert drives.loc["x", "new_zero_mm"] == pytest.approx(numbers.drives[0].new_zero * 1e3)
    assert str(numbers) == numbers.text()
    assert repr(numbers) == f"<{numbers.text().splitlines()[0]}>"
    points = og.read_tcp(RIG / "rig-2.tcp.csv")
    assert points.to_frame()["p_y_mm"].to_numpy() == pytest.approx(points.points().p[:, 1] * 1e3)
    shown = [frame_of._repr_html_() for frame_of in (found, numbers, points)]
    assert all(page.startswith("<table><caption>") for page in shown)


def test_a_suggestion_of_no_reading_does_not_count_readings() -> None:
    """ "<Suggestion, 0 readings: 12 further dial readings ..." contradicted itself."""
    told = "12 further dial readings on the legs would reduce the standard deviation by less"
    none = Suggestion(told, "none", 1.0, None)
    assert repr(none) == f"<Suggestion of no reading: {told}>"
    assert repr(replace(none, chosen=(3,))) == f"<Suggestion, 1 reading: {told}>"
    assert repr(replace(none, chosen=(3, 3))) == f"<Suggestion, 2 readings: {told}>"


def test_what_is_shown_of_readings_to_take(estimate: og.Estimate) -> None:
    chosen = og.design(og.Machine.nominal(), count=6)
    assert len(chosen.to_frame()) >= 6
    assert repr(chosen) == "<Design: 6 readings for 6 parameters>"
    assert chosen._repr_html_() == chosen.campaign._repr_html_()
    for one in og.next_measurements(estimate):
        assert len(one.to_frame()) == len(one.rows)
        chosen_rows = len(one.chosen)
        assert chosen_rows != 1
        of_readings = f", {chosen_rows} readings: " if chosen_rows else " of no reading: "
        assert repr(one).startswith(f"<Suggestion{of_readings}{one.reason}")
        assert len(repr(one)) < 400
        assert one._repr_html_().count("<tr>") in (len(one.rows) + 1, 22)


# -- threads of the linear algebra -----------------------------------------------------------------


def threads() -> list[int]:
    found = threadpoolctl.threadpool_info()
    return [one["num_threads"] for one in found if one["user_api"] == "blas"]


def test_one_thread_within_and_the_callers_own_after() -> None:
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        given = threads()
        assert on_one_thread(threads)() == [1] * len(given)
        assert threads() == given


def test_what_takes_long_runs_on_one_thread(monkeypatch) -> None:
    seen: list[int] = []
    campaign = og.simulate(og.Machine.nominal(), og.protocol("standard"), seed=1)
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        og.close_loop([campaign], progress=lambda step: seen.extend(threads()))
    assert seen
    assert set(seen) == {1}
