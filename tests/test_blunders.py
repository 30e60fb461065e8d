"""Faults of the data are found and named, and physics is not taken for one."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.attribution_cases import Case
from benchmarks.attribution_run import draw
from orthoglide.errors import InputError
from orthoglide.explanation.alternative_readings import alternatives, open_setups
from orthoglide.explanation.data_faults import Blunder, find_faults, without
from orthoglide.explanation.identifying import identify
from orthoglide.fit import Estimate, solve
from orthoglide.machine import Machine
from orthoglide.machine_file import Controller
from orthoglide.observations import Campaign, read_campaign
from orthoglide.simulation import simulate_tcp
from orthoglide.verdict import close_loop
from tests import rig_campaigns as rc
from tests.rig import Rig

ROOT = Path(__file__).parents[1]
RIG = ROOT / "tests" / "data" / "rig"
PUBLISHED = ROOT / "orthoglide" / "data"
BASE = {"joint_offset.x": 1.2e-3, "joint_offset.y": -0.8e-3, "joint_offset.z": 0.6e-3}
BASE |= {"leg_length.x": 4e-5, "leg_length.z": -6e-5}


@pytest.fixture(scope="module")
def nominal() -> Machine:
    return Machine.nominal()


def rows_of(protocol: str = "sweep", seed: int = 0, rig: Rig | None = None, **errors: float):
    rng = np.random.default_rng(seed)
    own = (rig or Rig()).with_errors(BASE | errors)
    return rc.simulate(own, protocol, rng, background=0.02)


def campaign_of(rows: list[rc.Row], machine: Machine, name: str = "campaign") -> Campaign:
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    return Campaign.from_frame(columns, name=name, machine_file=machine.spec)


def estimate_of(rows: list[rc.Row], machine: Machine) -> Estimate:
    return identify(campaign_of(rows, machine), machine, method="nested")


def found_in(rows: list[rc.Row], machine: Machine) -> tuple[Blunder, ...]:
    return find_faults(estimate_of(rows, machine)).blunders


# -- nothing where there is nothing ----------------------------------------------------------------


@pytest.mark.thorough(except_for=["1", "2", "4", "8"])
@pytest.mark.parametrize("k", range(1, 9))
def test_the_rig_campaigns_have_no_faults(k, machine):
    campaign = read_campaign(RIG / f"rig-{k}.csv", machine.spec)
    estimate = identify(campaign, machine, method="nested")
    assert find_faults(estimate).blunders == ()


@pytest.mark.thorough(except_for=["1-differences", "2-differences", "3-differences"])
@pytest.mark.parametrize("name", ["1-differences", "2", "2-differences", "3", "3-differences"])
def test_the_published_experiments_have_no_faults(name, nominal):
    file = PUBLISHED / f"experiment{name}.csv"
    estimate = identify(read_campaign(file, nominal.spec), nominal, method="nested")
    assert find_faults(estimate).blunders == ()


@pytest.mark.thorough(
    except_for=[
        "clean-standard",
        "clean-sweep",
        "axis_tilt.y.z-standard",
        "gauge_drift.xy-0.5-standard",
        "gauge_scale.yz-0.5-standard",
    ]
)
@pytest.mark.parametrize("protocol", ["standard", "sweep"])
@pytest.mark.parametrize(
    "errors",
    [
        {},
        {"axis_tilt.y.z": 3e-3},
        {"backlash.x": 1e-4},
        {"gauge_drift.xy-0.5": 1e-7},
        {"gauge_scale.yz-0.5": 0.05},
        {"rail_bow.z.x": 1e-4},
    ],
    ids=lambda e: next(iter(e), "clean"),
)
def test_an_effect_is_no_fault(protocol, errors, machine, nominal):
    rows = rows_of(protocol, seed=7, **errors)
    assert found_in(rows, machine) == ()
    assert found_in(rows, nominal) == ()


@pytest.mark.thorough(except_for=["warming drive"])
@pytest.mark.parametrize(
    "extra",
    [rc.wavy_rail(0, 1, 1e-4), rc.warming_drive(1, 1e-4), rc.s_curve(2, 0, 1e-4)],
    ids=["wavy rail", "warming drive", "s-curve"],
)
def test_an_effect_in_no_catalogue_is_no_fault(extra, machine):
    assert found_in(rows_of(seed=3, rig=Rig(extra=(extra,))), machine) == ()


# -- each kind -------------------------------------------------------------------------------------


@pytest.mark.thorough(except_for=["0.1-standard-alone"])
@pytest.mark.parametrize("errors", [{}, {"axis_tilt.y.z": 2e-3}], ids=["alone", "beside a tilt"])
@pytest.mark.parametrize("protocol", ["standard", "sweep"])
@pytest.mark.parametrize("size", [0.1, -1.0])
def test_outlier(protocol, size, errors, machine, nominal):
    rows = rows_of(protocol, seed=1, **errors)
    spoilt = rc.outlier(rows, 20, size).rows
    for judge in (machine, nominal):
        (blunder,) = found_in(spoilt, judge)
        assert blunder.kind == "outlier"
        assert blunder.rows == ((0, 20),)
        assert blunder.setups == (rows[20]["setup"],)


@pytest.mark.thorough(except_for=["-0.5-standard"])
@pytest.mark.parametrize("protocol", ["standard", "sweep"])
@pytest.mark.parametrize("step", [0.1, -0.5])
def test_knocked_stand(protocol, step, machine, nominal):
    spoilt, touched = rc.knocked_stand(rows_of(protocol, seed=2), "yz-0.5", step)
    for judge in (machine, nominal):
        (blunder,) = found_in(spoilt, judge)
        assert (blunder.kind, blunder.setups) == ("knocked_stand", ("yz-0.5",))
        assert [row for _, row in blunder.rows] == touched


@pytest.mark.thorough
@pytest.mark.parametrize(
    "setups",
    [["yz-0.5"], pytest.param([], marks=pytest.mark.thorough)],
    ids=["one", "all"],
)
def test_a_dial_set_to_zero_anew_at_each_repeat(setups, machine, nominal):
    """Three data were a creeping stand and a bent rail, and of all dials noise."""
    rng, rows = np.random.default_rng(4), rows_of("sweep", seed=2)
    names = setups or list(dict.fromkeys(row["setup"] for row in rows))
    by_repeat = {
        name: dict(zip((1, 2, 3), rng.uniform(-0.4, 0.4, 3), strict=True)) for name in names
    }
    later, expected = [], []
    for name, datum in by_repeat.items():
        own = [k for k, row in enumerate(rows) if row["setup"] == name]
        for k in own:
            rows[k]["reading_mm"] = round(rows[k]["reading_mm"] + datum[rows[k]["repeat"]], 2)
        later += [k for k in own if rows[k]["repeat"] > 1]
        expected += [(f"{r}", datum[r] - datum[1]) for r in (2, 3)]
    for judge in (machine, nominal):
        (blunder,) = found_in(rows, judge)
        assert (blunder.kind, blunder.setups) == ("zeroed", tuple(names))
        assert [row for _, row in blunder.rows] == sorted(later)
        told = re.findall(r"([+−][0-9.]+) mm at repeat (\d)", blunder.message)
        assert [repeat for _, repeat in told] == [repeat for repeat, _ in expected]
        for (size, _), (_, step) in zip(told, expected, strict=True):
            assert float(size.replace("−", "-")) == pytest.approx(step, abs=0.015)
        plural = "s" * (len(names) > 1)
        assert f"as if the dial{plural} had been set to zero anew" in blunder.message
    kept = close_loop(campaign_of(rows, machine), machine)
    assert kept.word == "adequate"


@pytest.mark.thorough
def test_who_sets_most_dials_to_zero_anew_does_so_with_all(nominal):
    """Steps of one or two graduations, of which single ones are drift or noise: those of three
    dials were told, and a dial was said to creep.
    """
    rng = np.random.default_rng(0)
    rows = rc.simulate(Rig(errors=BASE), rc.protocol_rows("sweep", repeats=4), rng, background=0.02)
    names = list(dict.fromkeys(row["setup"] for row in rows))
    datum = {
        (name, repeat): round(0.03 * rng.choice([-1, 1]) * rng.uniform(0.5, 1), 2)
        for name in names for repeat in (2, 3, 4)
    }  # fmt: skip
    for row in rows:
        row["reading_mm"] += datum.get((row["setup"], row["repeat"]), 0.0)
    verdict = close_loop(campaign_of(rows, nominal), nominal)
    (blunder,) = verdict.blunders
    assert (blunder.kind, blunder.setups) == ("zeroed", tuple(names))
    told = re.findall(r"([+−][0-9.]+) mm at repeat", blunder.message)
    for size, step in zip(told, datum.values(), strict=True):
        assert float(size.replace("−", "-")) == pytest.approx(step, abs=0.01)
    assert verdict.word == "adequate"


@pytest.mark.thorough
@pytest.mark.parametrize("protocol", ["standard", "sweep"])
def test_two_repeats_and_all_dials_set_to_zero_between(protocol, machine, nominal):
    """A drift shows the same of two repeats: none is as large. The tilt was lost, 0.04 mm at the
    tool, under "nothing is wrong", or told as stands that creep.
    """
    rng = np.random.default_rng(1)
    rig = Rig(errors=BASE | {"axis_tilt.y.z": 3e-3})
    rows = rc.simulate(rig, rc.protocol_rows(protocol, repeats=2), rng, background=0.02)
    names = list(dict.fromkeys(row["setup"] for row in rows))
    for k, name in enumerate(names):
        for row in rows:
            if (row["setup"], row["repeat"]) == (name, 2):
                row["reading_mm"] = round(row["reading_mm"] + 0.4 - 0.15 * k, 2)
    for judge in (machine, nominal):
        verdict = close_loop(campaign_of(rows, judge), judge)
        (blunder,) = verdict.blunders
        assert (blunder.kind, blunder.setups) == ("zeroed", tuple(names))
        told = re.findall(r"(\S+): ([+−][0-9.]+) mm at repeat 2", blunder.message)
        assert [name for name, _ in told] == names
        for k, (_, size) in enumerate(told):
            assert float(size.replace("−", "-")) == pytest.approx(0.4 - 0.15 * k, abs=0.02)
        assert {n for c in verdict.effects for n in (c.name, *c.indistinguishable_from)} >= {
            "axis_tilt.y.z"
        }


def test_sign(machine):
    (blunder,) = found_in(rc.swapped_sign(rows_of(), "yz-0.5").rows, machine)
    assert (blunder.kind, blunder.setups) == ("sign", ("yz-0.5",))
    assert "direction -z instead of z" in blunder.message


@pytest.mark.thorough(except_for=["zy-0.5-0.003"])
@pytest.mark.parametrize("tilt", [1e-3, 3e-3])
@pytest.mark.parametrize("setup", ["xy-0.5", "yz-0.5", "zy-0.5"])
def test_a_sign_beside_a_tilt(setup, tilt, nominal):
    rows = rows_of("standard", **{"axis_tilt.y.z": tilt})
    (blunder,) = found_in(rc.swapped_sign(rows, setup).rows, nominal)
    assert (blunder.kind, blunder.setups) == ("sign", (setup,))


@pytest.mark.thorough
def test_exchanged_labels_beside_a_tilt(machine):
    one, other = "zx-0.5", "xz-0.5"
    rows = rows_of("standard", **{"axis_tilt.y.z": 3e-3})
    (blunder,) = found_in(rc.swapped_labels(rows, one, other).rows, machine)
    assert blunder.kind == "exchanged_labels"
    assert set(blunder.setups) == {one, other}


@pytest.mark.thorough
@pytest.mark.parametrize("protocol", ["standard", "sweep"])
def test_two_large_effects_are_no_fault(protocol, machine, nominal):
    rows = rows_of(protocol, seed=7, **{"axis_tilt.y.z": 8e-3, "rail_bow.z.x": 1.6e-4})
    assert found_in(rows, machine) == ()
    assert found_in(rows, nominal) == ()


@pytest.mark.thorough(except_for=["same leg"])
@pytest.mark.parametrize("other", ["yx-0.5", "xz-0.5"], ids=["same leg", "another leg"])
def test_exchanged_labels(other, machine):
    (blunder,) = found_in(rc.swapped_labels(rows_of(), "yz-0.5", other).rows, machine)
    assert blunder.kind == "exchanged_labels"
    assert set(blunder.setups) == {"yz-0.5", other}


@pytest.mark.thorough
@pytest.mark.parametrize("one", ["xy-0.5", "yx-0.5", "xz-0.5"])
@pytest.mark.parametrize("seed", [0, 3])
def test_exchanged_dials_of_one_direction(one, seed, machine):
    """They read nearly alike: a tilt of the path explained them nearly as well, by 9 mrad."""
    other = {"xy-0.5": "zy-0.5", "yx-0.5": "zx-0.5", "xz-0.5": "yz-0.5"}[one]
    off = {"joint_offset.x": 8e-4, "leg_length.y": 5e-5}
    rng = np.random.default_rng(seed)
    rows = rc.simulate(Rig(errors=off), rc.protocol_rows("sweep"), rng, noise=5e-6)
    (blunder,) = found_in(rc.swapped_labels(rows, one, other).rows, machine)
    assert blunder.kind in (
        "exchanged_labels",
        "label",
    )  # one label that is wrong fits nearly as well
    assert set(blunder.setups) <= {one, other}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("protocol", "by", "errors"),
    [
        ("sweep", 1, {"rail_bow.x.z": 1.2e-4}),
        ("sweep", -1, {}),
        pytest.param("two-gauges", -1, {"rail_bow.x.z": 1.2e-4}, marks=pytest.mark.thorough),
    ],
    ids=["late beside a bow", "early", "early beside a bow"],
)
def test_readings_a_row_off(protocol, by, errors, machine):
    """They were told of the side that places are come to from, as a place in the machine."""
    rows = rows_of(protocol, seed=4, **errors)
    setup = "yz-0.5" if protocol == "sweep" else "yz-0.35"
    verdict = close_loop([campaign_of(rc.shifted_rows(rows, setup, by).rows, machine)], machine)
    (blunder,) = verdict.blunders
    assert (blunder.kind, blunder.setups) == ("shifted", (setup,))
    assert f"move them {'up' if by > 0 else 'down'} by one" in blunder.message
    assert not verdict.located


@pytest.mark.thorough(except_for=["leg-standard"])
@pytest.mark.parametrize(
    ("column", "protocol"), [("leg", "standard"), ("direction", "standard"), ("direction", "sweep")]
)
def test_a_label_of_another_leg_or_direction(column, protocol, machine):
    """It was told of a drive or of the dial's range, as a place in the machine."""
    (blunder,) = found_in(rc.wrong_label(rows_of(protocol), "yz-0.5", column).rows, machine)
    assert (blunder.kind, blunder.setups) == ("label", ("yz-0.5",))
    assert "as those of a dial on leg y that reads along z" in blunder.message


def test_a_label_puts_no_two_dials_at_one_place_at_once(machine):
    """A wrong command at one posture was told of a dial whose place the other one takes."""
    problem = estimate_of(rows_of("standard"), machine).problem
    setups = problem.setups
    labels = [a.fault for a in alternatives(problem, open_setups(problem, [])) if a.labels]
    tried = {f.label for f in labels if f.kind == "label" and setups[f.setups[0]].name == "xy-0.5"}
    assert tried == {(1, 0), (1, 2), (2, 0), (2, 1)}


def posture_of(rows: list[rc.Row], leg: str, label: str) -> int:
    """Its number, as `rc.wrong_command` counts."""
    keys = [(r["leg"], r["posture"]) for r in rows]
    return list(dict.fromkeys(keys)).index((leg, label))


@pytest.mark.thorough(except_for=["sweep-alone-3.0"])
@pytest.mark.parametrize("mm", [3.0, pytest.param(1.0, marks=pytest.mark.thorough), -10.0])
@pytest.mark.parametrize("errors", [{}, {"axis_tilt.y.z": 2e-3}], ids=["alone", "beside a tilt"])
@pytest.mark.parametrize(
    "protocol", ["sweep", pytest.param("two-gauges", marks=pytest.mark.thorough)]
)
def test_a_command_that_is_not_the_one_written(protocol, errors, mm, machine, nominal):
    """It was told of dials that show 85 % less, or of a drive."""
    rows = rows_of(protocol, seed=2, **errors)
    spoilt, touched = rc.wrong_command(rows, posture_of(rows, "y", "+20"), 0, mm)
    for judge in (machine, nominal):
        (blunder,) = found_in(spoilt, judge)
        assert blunder.kind == "command"
        assert [row for _, row in blunder.rows] == touched
        (drive, size), *others = blunder.commands
        assert (drive, others) == (0, [])
        assert size * 1e3 == pytest.approx(-mm, abs=0.1)
        written, meant = (of[touched[0]]["rho_x_mm"] for of in (spoilt, rows))
        said = f"fit with rho_x = {written + size * 1e3:.2f} mm where {written:.8g} is written"
        assert said in blunder.message
        assert abs(written + size * 1e3 - meant) < 0.1
        assert "off at this place" not in blunder.message


@pytest.mark.thorough
def test_a_command_of_the_drive_along_its_own_leg_may_be_the_machine(machine):
    """No other posture goes there: the drive may be wrong at that place."""
    rows = rows_of(seed=2)
    spoilt, touched = rc.wrong_command(rows, posture_of(rows, "y", "+40"), 1, 1.0)
    (blunder,) = found_in(spoilt, machine)
    assert (blunder.kind, blunder.setups) == ("command", ("yx-0.5", "yz-0.5"))
    assert [row for _, row in blunder.rows] == touched
    assert "or drive y is off at this place alone: measure it again" in blunder.message


@pytest.mark.thorough
def test_a_wrong_command_beside_points_of_the_tool(machine):
    """Their rows were counted among those of dials: a ValueError."""
    rows = rows_of(seed=2)
    spoilt, touched = rc.wrong_command(rows, posture_of(rows, "y", "+20"), 0, 1.0)
    points = simulate_tcp(machine.with_parameters(BASE), 20, seed=1)
    estimate = identify([campaign_of(spoilt, machine), points], machine)
    (blunder,) = find_faults(estimate).blunders
    assert blunder.kind == "command"
    assert [row for _, row in blunder.rows] == touched


@pytest.mark.thorough
def test_a_command_of_one_visit_alone(machine):
    rows = rows_of(seed=2)
    spoilt = [dict(row) for row in rows]
    for row in spoilt[60:62]:
        row["rho_x_mm"] += 10.0
    (blunder,) = found_in(spoilt, machine)
    assert (blunder.kind, blunder.rows) == ("command", ((0, 60), (0, 61)))
    assert "off at this place" not in blunder.message


@pytest.mark.thorough
def test_a_wrong_command_in_a_setup_with_an_outlier(machine):
    rows = rc.outlier(rows_of(seed=5), 30, 0.3).rows
    rows, touched = rc.wrong_command(rows, posture_of(rows, "x", "-50"), 2, 3.0)
    outlier, command = found_in(rows, machine)
    assert (outlier.kind, outlier.rows) == ("outlier", ((0, 30),))
    assert command.kind == "command"
    assert [row for _, row in command.rows] == touched


def test_a_wrong_command_is_told_as_the_controller_has_it(machine):
    own = replace(machine.spec, controller=Controller((0.01, 0.0, 0.0), (-1, 1, 1)))
    judge = Machine(own)
    rows = rows_of(seed=2)
    spoilt = rc.wrong_command(rows, posture_of(rows, "y", "+20"), 0, 1.0).rows
    (blunder,) = found_in(spoilt, judge)
    assert re.search(r"\(the controller's 10\.6\d where 9\.645313\) is written", blunder.message), (
        blunder.message
    )


@pytest.mark.thorough
def test_neighbours_of_a_wrong_command_are_reached_from_their_own_side(machine):
    """The step to the next posture had the other sign, by the command as it was written."""
    rows = rows_of(seed=2)
    spoilt, touched = rc.wrong_command(rows, posture_of(rows, "y", "+20"), 0, 3.0)
    estimate = estimate_of(spoilt, machine)
    (clean,) = without(estimate.problem, find_faults(estimate).blunders).campaigns
    sound, wrong = campaign_of(rows, machine), campaign_of(spoilt, machine)
    kept = np.delete(np.arange(len(rows)), touched)
    assert (wrong.approach[kept] != sound.approach[kept]).any()
    np.testing.assert_array_equal(clean.approach, sound.approach[kept])


@pytest.mark.thorough
@pytest.mark.parametrize("what", ["kinked_rail", "stick_slip", "wavy_rail", "drive_step"])
def test_what_is_wrong_along_a_rail_is_no_wrong_command(what, machine):
    drawn = draw(Case("outside", what, "sweep", 12.0, 0), 2029)
    assert [b for b in found_in(drawn.rows, machine) if b.kind == "command"] == []


@pytest.mark.thorough
@pytest.mark.parametrize(("protocol", "rms"), [("fine-sweep", 6.0), ("sweep", 12.0)])
def test_a_drive_that_goes_with_another_is_no_wrong_label(protocol, rms, machine):
    """It imitates one, but not in its full size."""
    drawn = draw(Case("outside", "cross_coupling", protocol, rms, 1), 2029)
    assert found_in(drawn.rows, machine) == ()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("factor", "said"),
    [(1e-3, "in metres"), (1 / 25.4, "in inches"), (10.0, "decimal point")],
)
def test_unit(factor, said, machine):
    (blunder,) = found_in(rc.wrong_unit(rows_of(), "yz-0.5", factor).rows, machine)
    assert (blunder.kind, blunder.setups) == ("unit", ("yz-0.5",))
    assert said in blunder.message


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("protocol", "setup", "errors"),
    [
        ("sweep", "yz-0.5", {"axis_tilt.y.z": 2e-3}),
        ("sweep", "xy-0.5", {"rail_bow.x.z": 1.2e-4}),
        ("standard", "xy-0.5", {"axis_tilt.y.z": 2e-3}),
    ],
    ids=["beside a tilt", "beside a bow", "few readings"],
)
@pytest.mark.parametrize("step", [1e-4, 5e-4])
def test_a_dial_in_inches(step, protocol, setup, errors, machine):
    """Hundredths were told, or effects that there are not."""
    rows = rows_of(protocol, seed=2, **errors)
    spoilt, touched = rc.wrong_unit(rows, setup, 1 / 25.4)
    for k in touched:
        spoilt[k]["reading_mm"] = round(round(spoilt[k]["reading_mm"] / step) * step, 4)
    (blunder,) = found_in(spoilt, machine)
    assert (blunder.kind, blunder.setups) == ("unit", (setup,))
    assert "multiplied by 25.4, so they seem to be in inches" in blunder.message


@pytest.mark.thorough
@pytest.mark.parametrize("turn", [1.0, pytest.param(0.5, marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    ("protocol", "errors"),
    [("sweep", {}), ("sweep", {"axis_tilt.y.z": 2e-3}), ("standard", {"axis_tilt.y.z": 2e-3})],
    ids=["alone", "beside a tilt", "few readings beside a tilt"],
)
def test_who_reads_the_large_hand_alone(protocol, errors, turn, machine, nominal):
    """It was told of a rail that leaves its line, by half a millimetre."""
    spoilt, touched = rc.whole_turns(rows_of(protocol, seed=3, **errors), "zx-0.5", turn)
    assert touched
    (blunder,) = found_in(spoilt, machine if turn == 1 else nominal)
    assert (blunder.kind, blunder.setups) == ("turns", ("zx-0.5",))
    assert [row for _, row in blunder.rows] == touched
    assert f"a hand that shows {turn:g} mm by each: read the small hand" in blunder.message


@pytest.mark.thorough
def test_who_reads_the_large_hand_of_every_dial_alone(machine):
    """Three rails and wrong zeros were told."""
    spoilt, off = rows_of(seed=1, **{"axis_tilt.y.z": 2e-3}), []
    for setup in dict.fromkeys(row["setup"] for row in spoilt):
        spoilt, touched = rc.whole_turns(spoilt, setup, 1.0)
        off += touched
    (blunder,) = found_in(spoilt, machine)
    assert (blunder.kind, blunder.setups) == ("turns", ("xz-0.5", "yx-0.5"))
    assert [row for _, row in blunder.rows] == sorted(off)


@pytest.mark.thorough
@pytest.mark.parametrize("errors", [{}, {"rail_bow.x.z": 1.2e-4}], ids=["alone", "beside a bow"])
def test_a_posture_a_turn_off_in_one_dial(errors, machine):
    """It was told as a wrong command."""
    spoilt, touched = rc.a_turn_off(rows_of(seed=2, **errors), "zx-0.5", "+20")
    (blunder,) = found_in(spoilt, machine)
    assert (blunder.kind, blunder.setups) == ("turns", ("zx-0.5",))
    assert [row for _, row in blunder.rows] == touched
    assert "readings are +1 mm off the setup's others" in blunder.message


@pytest.mark.thorough(except_for=["standard"])
@pytest.mark.parametrize("protocol", ["standard", "sweep"])
def test_stuck_dial(protocol, machine):
    spoilt, touched = rc.stuck_dial(rows_of(protocol), "yz-0.5")
    (blunder,) = found_in(spoilt, machine)
    assert (blunder.kind, blunder.setups) == ("stuck", ("yz-0.5",))
    assert len({row for _, row in blunder.rows} ^ set(touched)) <= 1


@pytest.mark.thorough
def test_a_slip_in_most_setups_is_found_in_each(machine, nominal):
    """Noise from repeats has grown by them, and what a setup scatters is no measure of it."""
    rows, slipped = rows_of("standard"), (2, 5, 20, 23, 41)
    for k in slipped:
        rows = rc.outlier(rows, k, 0.11).rows
    assert len({rows[k]["setup"] for k in slipped}) == 5
    for judge in (machine, nominal):
        found = found_in(rows, judge)
        assert {b.kind for b in found} == {"outlier"}
        assert sorted(row for b in found for _, row in b.rows) == list(slipped)


@pytest.mark.thorough
@pytest.mark.parametrize("protocol", ["standard", "sweep"])
def test_a_dial_that_stuck_from_its_first_reading(protocol, machine, nominal):
    """Nothing of its setup is left that repeats could be compared with."""
    rows = rows_of(protocol)
    own = [k for k, row in enumerate(rows) if row["setup"] == "zx-0.5"]
    for k in own:
        rows[k]["reading_mm"] = rows[own[0]]["reading_mm"]
    for judge in (machine, nominal):
        (blunder,) = found_in(rows, judge)
        assert (blunder.kind, blunder.setups) == ("stuck", ("zx-0.5",))
        assert [row for _, row in blunder.rows] == own


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [1e-6, 5e-6])
@pytest.mark.parametrize("tilt", [0.0, 2e-3])
def test_a_dial_that_stuck_where_an_effect_would_undo_what_it_missed(tilt, noise, machine, nominal):
    """A tilt of just the right size is no better explanation, whatever else is tilted."""
    errors = {"joint_offset.x": 3e-4, "joint_offset.y": -2e-4, "joint_offset.z": 2.5e-4}
    rig = Rig(errors=errors | {"axis_tilt.x.y": tilt})
    rows = rc.simulate(rig, "sweep", np.random.default_rng(3), noise=noise, background=0.015)
    moved = np.ptp([row["reading_mm"] for row in rows if row["setup"] == "zx-0.5"])
    assert 0.05 < moved < 0.25
    spoilt, touched = rc.stuck_dial(rows, "zx-0.5", 0.0)
    for judge in (machine, nominal):
        (blunder,) = found_in(spoilt, judge)
        assert (blunder.kind, blunder.setups) == ("stuck", ("zx-0.5",))
        assert [row for _, row in blunder.rows] == touched


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("protocol", "effect", "size"),
    [
        ("two-gauges", "axis_offset.x.y", 8e-4),
        ("two-gauges", "rail_tilt.y.x", 8e-4),
        ("sweep", "parallelogram_width.x", 2.9e-3),
    ],
)
def test_a_dial_that_has_nothing_to_show_did_not_stick(protocol, effect, size, machine, nominal):
    """Without that effect, far beyond its tolerance or not, it would have many divisions to go."""
    rig = Rig(errors={effect: size})
    rows = rc.simulate(rig, protocol, np.random.default_rng(1), noise=2e-7, background=0.01)
    shown = {
        s: [r["reading_mm"] for r in rows if r["setup"] == s] for s in {r["setup"] for r in rows}
    }
    assert any(np.ptp(readings) == 0 for readings in shown.values())
    for judge in (machine, nominal):
        assert found_in(rows, judge) == ()


@pytest.mark.thorough
def test_several_faults(machine):
    rows = rc.outlier(rows_of(seed=5), 30, 0.3).rows
    rows = rc.knocked_stand(rows, "zx-0.5", 0.2).rows
    rows = rc.swapped_sign(rows, "yz-0.5").rows
    found = {b.kind: b for b in found_in(rows, machine)}
    assert set(found) == {"outlier", "knocked_stand", "sign"}
    assert found["outlier"].rows == ((0, 30),)
    assert found["sign"].setups == ("yz-0.5",)


@pytest.mark.thorough
def test_a_machine_that_looks_like_exchanged_labels_is_told_as_that(machine):
    """One drive that goes with another's command shows as two dials that changed places."""
    drawn = draw(Case("outside", "cross_coupling", "fine-sweep", 12.0, 1), 2027)
    verdict = close_loop([campaign_of(drawn.rows, machine)], machine)
    assert not verdict.blunders
    assert verdict.word == "located"
    (found,) = verdict.located
    assert [c.name for c in found.members] == ["drive.y/command.z"]


@pytest.mark.thorough
def test_a_fault_that_no_machine_shows_has_no_rival(machine):
    spoilt = rc.swapped_sign(rows_of(), "yz-0.5").rows
    (blunder,) = close_loop([campaign_of(spoilt, machine)], machine).blunders
    assert blunder.kind == "sign"
    assert "as they stand" not in blunder.message


# -- what is told, and what is left ----------------------------------------------------------------


def test_the_message_names_file_line_setup_and_remedy(tmp_path, machine):
    path = tmp_path / "monday.csv"
    rc.write_csv(rc.outlier(rows_of("standard"), 20, 0.5).rows, path)
    campaign = read_campaign(path, machine.spec)
    estimate = identify(campaign, machine, method="nested")
    (blunder,) = find_faults(estimate).blunders
    assert blunder.message.startswith("monday.csv, line 22, setup 'yx-0.5', posture max: ")
    assert "measure this place again" in blunder.message
    assert blunder.lines([campaign]) == {str(path): (22,)}


def test_scores_with_and_without(nominal):
    estimate = estimate_of(rc.outlier(rows_of("standard"), 20, 0.5).rows, nominal)
    blunders = find_faults(estimate).blunders
    again = solve(without(estimate.problem, blunders), method="nested")
    (blunder,) = blunders
    assert blunder.rms_with == pytest.approx(estimate.scores.rms, rel=1e-6)
    assert blunder.rms_without < 0.3 * blunder.rms_with
    assert len(again.residuals) == len(estimate.residuals) - 1
    # The noise was that of the repeats, the slip among them.
    assert again.problem.noise.typical < 0.3 * estimate.problem.noise.typical


def test_a_knocked_setup_becomes_two(machine):
    rows, touched = rc.knocked_stand(rows_of(seed=2), "yz-0.5", 0.5)
    estimate = estimate_of(rows, machine)
    clean = without(estimate.problem, find_faults(estimate).blunders)
    (campaign,) = clean.campaigns
    assert len(campaign) == len(rows)
    assert len(campaign.setups) == 7
    second = [k for k, s in enumerate(campaign.setup) if s == 6]
    assert second == touched
    assert campaign.setups[6].leg == campaign.setups[campaign.setup[touched[0] - 2]].leg
    again = solve(clean, method="nested")
    untouched = estimate_of(rows_of(seed=2), machine)
    assert again.scores.rms < 1.1 * untouched.scores.rms
    np.testing.assert_allclose(again.x, untouched.x, atol=3 * np.sqrt(untouched.covariance[0, 0]))


@pytest.mark.thorough
def test_two_knocks_of_one_setup_make_three(machine):
    rows = rc.knocked_stand(rows_of(seed=2), "yz-0.5", 0.5, after=0.3).rows
    rows = rc.knocked_stand(rows, "yz-0.5", -0.3, after=0.7).rows
    estimate = estimate_of(rows, machine)
    blunders = find_faults(estimate).blunders
    assert [b.kind for b in blunders] == ["knocked_stand", "knocked_stand"]
    for order in (blunders, blunders[::-1]):
        (campaign,) = without(estimate.problem, order).campaigns
        sizes = np.bincount(campaign.setup)
        assert sorted(sizes.tolist())[:3] == [13, 13, 16]


def test_rows_are_counted_within_their_campaign(machine):
    first = campaign_of(rows_of("standard", seed=1), machine, "first")
    second = campaign_of(rc.outlier(rows_of("standard", seed=2), 11, 0.5).rows, machine, "second")
    estimate = identify([first, second], machine, method="nested")
    (blunder,) = find_faults(estimate).blunders
    assert blunder.rows == ((1, 11),)
    assert blunder.message.startswith("second, line 13,")
    clean = without(estimate.problem, [blunder])
    assert [len(c) for c in clean.campaigns] == [54, 53]


def test_a_campaign_of_faults_alone_is_refused(machine):
    estimate = estimate_of(rows_of("standard"), machine)
    names = tuple(s.name for s in estimate.problem.campaigns[0].setups)
    every = Blunder("unit", tuple((0, k) for k in range(54)), names, "", 0.0, 0.0, 0.0)
    with pytest.raises(InputError, match="nothing is left of campaign"):
        without(estimate.problem, [every])


def test_a_campaign_that_is_refused_is_told_its_own_fault(machine):
    every = [campaign_of(rows_of("standard", seed=k), machine, f"visit-{k}") for k in (1, 2)]
    problem = identify(every, machine, method="nested").problem
    first = Blunder("outlier", ((0, 3),), (), "visit-1, line 5", 0.0, 0.0, 0.0)
    whole = Blunder("unit", tuple((1, k) for k in range(54)), (), "visit-2 is in", 0.0, 0.0, 0.0)
    with pytest.raises(InputError, match=r"nothing is left of visit-2 .* \(visit-2 is in\)"):
        without(problem, [first, whole])


def test_the_same_readings_give_the_same_answer(machine):
    rows = rc.knocked_stand(rows_of("standard", seed=2), "yz-0.5", 0.1).rows
    assert found_in(rows, machine) == found_in(rows, machine)
