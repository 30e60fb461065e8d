"""Readings that are not what they seem: none of them may pass for a machine with nothing wrong."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import orthoglide as og
from benchmarks.attribution_cases import background, base_errors
from benchmarks.public import campaign as campaign_of
from orthoglide.errors import InputError
from orthoglide.fit import plausible
from orthoglide.machine_file.model import Measured
from orthoglide.simulation import simulate, simulate_tcp
from tests import rig_campaigns as rc
from tests.rig import Rig
from tests.studied import studied

RIG = Path(__file__).parent / "data" / "rig"
MACHINE = og.Machine.load(RIG / "machine.toml")


def rig(number: int = 2) -> og.Campaign:
    return og.read_campaign(RIG / f"rig-{number}.csv", MACHINE.spec)


def shuffled(campaign: og.Campaign, seed: int, within: bool) -> og.Campaign:
    rng = np.random.default_rng(seed)
    order = np.arange(len(campaign))
    for setup in range(len(campaign.setups)) if within else [slice(None)]:
        rows = np.flatnonzero(campaign.setup == setup) if within else order.copy()
        order[rows] = rng.permutation(rows)
    return campaign.with_readings(campaign.reading[order])


@pytest.mark.parametrize("within", [False, True], ids=["all", "within setups"])
@pytest.mark.parametrize("number", [2, 5])
def test_shuffled_readings_are_refused(number: int, within: bool) -> None:
    with pytest.raises(InputError, match=rf"rig-{number}.csv.*visits to the same posture scatter"):
        og.close_loop(shuffled(rig(number), 0, within))


@pytest.mark.thorough
@pytest.mark.parametrize(("drives", "protocol"), [((0, 1), "sweep"), ((1, 2), "standard")])
def test_commands_in_each_others_columns_are_refused(
    drives: tuple[int, int], protocol: str
) -> None:
    """They bent the machine, by tilts of milliradians and zeros that made it worse."""
    rng = np.random.default_rng(5)
    rows = rc.simulate(Rig(errors=base_errors(rng)), rc.protocol_rows(protocol), rng)
    one, other = ("xyz"[k] for k in drives)
    told = f"commands of drive {one} under {other} and of drive {other} under {one}"
    with pytest.raises(InputError, match=told):
        og.close_loop(campaign_of(rc.swapped_commands(rows, *drives).rows), MACHINE)
    # A machine that is far off is none of it.
    far = Rig(errors={**base_errors(rng), "axis_tilt.y.z": 2e-2, "axis_offset.x.y": 3e-3})
    studied(campaign_of(rc.simulate(far, rc.protocol_rows(protocol), rng)), MACHINE)


def test_other_orders_of_drives_that_fit_worse_are_not_solved(monkeypatch) -> None:
    """Of a machine that is far off, a linear fit of each order shows that the order is right."""
    rng = np.random.default_rng(5)
    far = Rig(errors={**base_errors(rng), "axis_tilt.y.z": 2e-2, "axis_offset.x.y": 3e-3})
    fit = og.identify(campaign_of(rc.simulate(far, rc.protocol_rows("standard"), rng)), MACHINE)
    assert fit.sigma_scale > 20
    monkeypatch.setattr(plausible, "solve", lambda *_, **__: pytest.fail("an order was solved"))
    assert plausible.exchanged_drives(fit) is None


def test_a_wrong_sign_is_found_beside_a_large_cause() -> None:
    """It was told as an offset of a short link and a second tilt, beside the true one."""
    rng = np.random.default_rng(5)
    leaning = Rig(errors={**base_errors(rng), "rail_tilt.z.y": 6e-3})
    rows = rc.simulate(leaning, rc.protocol_rows("standard"), rng)
    turned = rc.swapped_sign(rows, "zx-0.5").rows
    verdict = studied(campaign_of(turned), MACHINE)
    (fault,) = verdict.blunders
    assert (fault.kind, fault.setups) == ("sign", ("zx-0.5",))
    assert [cause.name for cause in verdict.effects] == ["rail_tilt.z.y"]
    assert verdict.effects[0].chosen.value == pytest.approx(6e-3, rel=0.1)


@pytest.mark.parametrize("draw", [22, pytest.param(7, marks=pytest.mark.thorough)])
def test_two_dials_with_each_others_label_are_no_exchange_of_commands(draw: int) -> None:
    """On worn machines, exchanged commands of both drives fit ten times better too."""
    rng = np.random.default_rng([9400, draw])
    rows = rc.protocol_rows("sweep")
    setups = list(dict.fromkeys(row["setup"] for row in rows))
    share = 1.0 if draw % 2 else 0.1
    worn = Rig(errors=background(rng, setups, share) | base_errors(rng))
    one, other = (s for s in setups if s[:2] in ("yz", "zy"))
    mixed, lines = rc.swapped_labels(rc.simulate(worn, rows, rng), one, other)
    verdict = studied(campaign_of(mixed), MACHINE)
    (fault,) = verdict.blunders
    assert fault.kind == "exchanged_labels"
    assert {row for _, row in fault.rows_in_request} == set(lines)


def test_one_dial_does_not_tell_whose_columns_were_exchanged() -> None:
    whole = rig()
    one = whole.subset(whole.setup == 0)
    with pytest.raises(InputError, match="do not show which"):
        og.identify(replace(one, command=one.command[:, [1, 0, 2]]), MACHINE)


@pytest.mark.parametrize("factor", [25.4, 1 / 25.4])
@pytest.mark.parametrize("ask", [og.close_loop, og.identify])
def test_inches_throughout_are_refused(ask, factor: float) -> None:
    spoilt = rig().with_readings(np.round(rig().reading * factor, 9))
    with pytest.raises(InputError, match=f"rig-2.csv.*multiplied by {1 / factor:.4g}"):
        ask(spoilt, MACHINE)


def test_millimetres_of_a_fine_dial_are_no_inches() -> None:
    finer = replace(MACHINE.spec, dial=replace(MACHINE.spec.dial, resolution=1e-9))
    og.identify(rig(), og.Machine(finer))


def test_a_bar_wrong_by_five_millimetres_is_told() -> None:
    length = 5e-3
    wrong = MACHINE.with_parameters({"leg_length.y": length})
    verdict = studied(simulate(wrong, "standard", noise=5e-6, seed=1), MACHINE)
    assert verdict.word == "explained"
    assert [cause.name for cause in verdict.effects] == ["leg_length.y"]
    assert verdict.effects[0].chosen.value == pytest.approx(length * 1e3, abs=0.5)
    (far,) = [w for w in verdict.after.warnings if w.kind == "tolerance"]
    told = r"leg length of leg y is ([+−])([0-9.]+) mm, ([0-9.]+) times its tolerance"
    ((sign, size, ratio),) = re.findall(told, far)
    assert (sign == "+") == (length > 0)
    assert float(size) == pytest.approx(5, rel=0.1)
    assert float(ratio) == pytest.approx(50, rel=0.1)
    assert verdict.after.values["leg_length.y"] == pytest.approx(length, rel=0.1)


def test_bars_of_one_wrong_length_are_one_cause() -> None:
    """Measured by one calliper, they were three."""
    known = replace(MACHINE.spec, measured=Measured(rods=(MACHINE.geometry.L + 2e-3, 2e-5)))
    right = MACHINE.with_parameters({f"leg_length.{leg}": 2e-3 for leg in "xyz"})
    read = simulate(right, "standard", noise=5e-6, seed=1)
    verdict = studied(read, og.Machine(known.with_measured()))
    assert [cause.name for cause in verdict.effects] == ["leg_length.common"]
    assert verdict.effects[0].chosen.value == pytest.approx(2.0, abs=0.2)


def tcp_points(slip: float, **more: float):
    truth = {"joint_offset.x": 1e-3, "leg_length.x": 1e-4, "axis_tilt.y.z": 1e-3, **more}
    points = simulate_tcp(MACHINE.with_parameters(truth), 40, seed=1)
    reading = points.reading + np.random.default_rng(0).normal(0, 1e-5, len(points))
    reading[3 * 7 + 1] += slip
    return replace(points, reading=reading, file="somewhere/points.csv")


@pytest.mark.parametrize(
    ("slip", "frame"),
    [(-0.01, "translation"), pytest.param(0.001, "rigid", marks=pytest.mark.thorough)],
)
def test_a_slip_in_a_tcp_point_is_named(slip: float, frame) -> None:
    (said,) = [w for w in og.identify(tcp_points(slip), MACHINE, frame=frame).warnings
               if w.kind == "slip"]  # fmt: skip
    assert re.search(r"points.csv, line 9: .* mm off what all others say", said)
    (fault,) = studied(tcp_points(slip), MACHINE, frame=frame).blunders
    assert fault.excluded
    assert re.search("points.csv, line 9: the point is .* mm off what all others", fault.message)


def test_copies_of_repeats_are_said() -> None:
    whole = rig()
    station = np.unique(whole.stations, axis=0, return_inverse=True)[1].reshape(-1)
    first = np.unique(station, return_index=True)[1]
    found = og.identify(whole.with_readings(whole.reading[first][station]), MACHINE)
    assert [w for w in found.warnings if w.kind == "copies" and "say nothing of the noise" in w]
    assert not [w for w in og.identify(whole, MACHINE).warnings if w.kind == "copies"]


# -- points of the tool ----------------------------------------------------------------------------


TRUTH = {
    "joint_offset.x": 4e-4,
    "joint_offset.y": -9e-4,
    "leg_length.z": 6e-5,
    "axis_tilt.z.x": 2e-3,
}


def measured(seed: int = 0) -> og.Readings:
    rng = np.random.default_rng(seed)
    rho = MACHINE.geometry.L + rng.uniform(*MACHINE.geometry.stroke, (40, 3))
    p = Rig(errors=TRUTH).pose(rho)[0] + rng.normal(0, 1e-6, (40, 3))
    lines = np.arange(2, len(rho) + 2)
    return og.Readings.from_points(rho, p, np.full(len(rho), 1e-6), np.zeros((len(rho), 3)), lines)


def test_too_few_points_and_dials_are_refused() -> None:
    points = measured()
    few = points.subset(points.order < 2)
    with pytest.raises(og.InputError, match="too few"):
        og.identify(few, MACHINE)
    with pytest.raises(og.InputError, match="nothing is free"):
        og.identify(points, MACHINE, ["gauge_scale"])
    with pytest.raises(og.UnidentifiableError, match="do not determine"):
        og.identify(points, MACHINE, ["joint_offset", "axis_offset"], frame="rigid", priors=False)


def test_points_that_judge_are_looked_at_as_well() -> None:
    """In another unit or a left-handed frame they would condemn a machine that is right."""
    dials, points = og.read_campaign(RIG / "rig-1.csv", MACHINE.spec), measured(30).points()
    for wrong, said in ((points.p / 25.4, "in inches"), (points.p * [1, -1, 1], "left-handed")):
        with pytest.raises(og.InputError, match=said):
            og.close_loop([dials], MACHINE, tcp=og.Readings.from_points(points.command, wrong))


def test_points_are_judged_by_what_they_are_known_to_themselves() -> None:
    """Noise of 20 um in the points is no error of a machine that is known to 1 um."""
    from orthoglide.closing.validation import points_contradiction, tcp_errors

    worn, rng = MACHINE.with_parameters(TRUTH), np.random.default_rng(2)
    rho = MACHINE.geometry.L + rng.uniform(*MACHINE.geometry.stroke, (40, 3))
    p = worn.forward(rho) + rng.normal(0, 2e-5, (40, 3))
    stated, lines = np.full((40, 3), 1e-6), np.arange(2, 42)

    def judged(sigma: float, after: dict[str, float]) -> tuple[float, str]:
        given = og.Readings.from_points(rho, p, np.full(40, sigma), np.zeros((40, 3)), lines)
        errors = tcp_errors(MACHINE, given, {}, after, stated)["translation"]
        return errors.inside, points_contradiction(errors, stated, given.points())

    assert judged(np.nan, worn.values)[0] < 0.2
    inside, said = judged(2e-5, worn.values)
    assert inside == pytest.approx(0.95, abs=0.06)
    assert not said
    _, said = judged(2e-5, {})
    assert said.startswith("the measured points fit this result neither with nor without what was")
    assert not judged(np.nan, {})[1]  # nobody knows how well they are known


@pytest.mark.thorough
def test_the_training_file_as_holdout_is_said() -> None:
    renamed = replace(rig(), name="other", file="other.csv")
    same = studied(rig(), MACHINE, holdout=renamed)
    assert [
        w for w in same.after.warnings if "100 % of the readings held out were also fitted" in w
    ]
    other = studied(rig(), MACHINE, holdout=rig(1))
    assert not [w for w in other.after.warnings if w.kind == "holdout"]
    points = [og.read_tcp(RIG / f"rig-{k}.tcp.csv", MACHINE.spec) for k in (1, 2)]
    for tcp, said in zip(points, (1, 0), strict=True):
        judged = studied([rig(1), points[0]], MACHINE, tcp=tcp)
        assert len([w for w in judged.after.warnings if w.kind == "holdout"]) == said
