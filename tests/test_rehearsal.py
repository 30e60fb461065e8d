"""Rehearsals: what is drawn, how it is scored, that workers and stops change nothing."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide.firmware.klipper import import_printer
from orthoglide.planning.sheets import instrument_sheet
from orthoglide.rehearsal.outcome import (
    ALL_EFFECTS,
    EFFECT,
    KIND_SEQUENCE,
    KINDS,
    OUTSIDE,
    Outcome,
    Rehearsal,
    Scope,
    check_tolerances,
    draw_machine,
    judge_claims,
    run_campaign,
)
from orthoglide.result import decoded, encoded
from tests.klipper_files import DATA
from tests.test_cli import run

MACHINE = Path(__file__).parent / "data" / "rig" / "machine.toml"


@pytest.fixture(scope="module")
def scope() -> Scope:
    machine = og.Machine.load(MACHINE)
    return Scope.of(machine, og.protocol("standard", machine.geometry))


def drawn(scope: Scope, kind: Any, number: int = 0) -> Any:
    return draw_machine(scope, kind, np.random.default_rng(number))


# --- what is drawn --------------------------------------------------------------------------------


def test_machines_are_off_by_their_tolerances(scope: Scope) -> None:
    machines = [drawn(scope, ALL_EFFECTS[1], k).machine for k in range(40)]
    for name, share in (("joint_offset.x", 1.0), ("axis_tilt.y.z", 0.3), ("backlash.z", 0.3)):
        sizes = [m.values[name] / m.tolerance(name) for m in machines]
        assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(share, rel=0.35), name


def test_tolerances_of_another_size_of_machine_are_refused(tmp_path: Path) -> None:
    """Of nine campaigns on a machine of 10 mm with the tolerances of one of 300 mm eight failed, as
    of loops that do not close and values in another unit.
    """
    size = "schema = 1\n[geometry_mm]\nL = 10.0\nd = 3.0\nr = 1.2\nstroke = [-3.0, 2.0]\n"
    (tmp_path / "micro.toml").write_text(size)
    refused = run("rehearse", tmp_path / "micro.toml", "--campaigns", "9", "--quiet")
    assert refused.exit_code == 2
    said, _, largest = refused.stderr.strip().partition(", at most ")
    assert "too large for a machine whose bars are 10 mm long: give" in said
    assert largest == "joint_offset = 0.33, axis_offset = 0.1"
    stated = "\n".join(["[tolerance]", *largest.split(", ")])
    (tmp_path / "micro.toml").write_text(size + stated)
    machine = og.Machine.load(tmp_path / "micro.toml")
    small = Scope.of(machine, og.protocol("standard", machine.geometry))
    check_tolerances(small)
    for number in range(20):
        for kind in KINDS:
            drawn(small, kind, number)


def test_no_warning_of_a_covariance_that_a_rehearsal_does_not_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orthoglide.rehearsal.rehearse", lambda *_, **__: SimpleNamespace(line=""))
    calibrated = og.Machine.load(MACHINE).with_parameters(
        {"joint_offset.x": 1e-3}, {"joint_offset.x": 1e-5}
    )
    calibrated.save(tmp_path / "calibrated.toml")
    assert "covariance" in str(og.Machine.load(tmp_path / "calibrated.toml").warnings)
    done = run("rehearse", tmp_path / "calibrated.toml", "--quiet")
    assert (done.exit_code, done.stderr) == (0, "")


# --- how it is scored -----------------------------------------------------------------------------


def test_one_effect_stands_out(scope: Scope) -> None:
    for k in range(30):
        one = drawn(scope, EFFECT, k)
        beyond = {n: v for n, v in one.machine.values.items() if n in one.sizes}
        assert one.cause
        assert set(beyond) == set(one.sizes)
        size = np.linalg.norm([v / one.machine.tolerance(n) for n, v in beyond.items()])
        assert 3 <= size <= 10
        assert size == pytest.approx(one.size)


def verdict_of(*effects: tuple[str, ...], places: tuple[str, ...] = ()) -> Any:
    """A verdict with causes, each by its credible set, and one class of places."""
    catalogue = og.Machine.nominal().catalogue

    def explanation(name: str) -> Any:
        own = [name] if "." in name else list(catalogue[name].motions)
        return SimpleNamespace(name=name, parameters=own, probability=0.5)

    causes = [
        SimpleNamespace(name=names[0], explanations=[explanation(n) for n in names])
        for names in effects
    ]
    members = [SimpleNamespace(name=place) for place in places]
    located = [SimpleNamespace(members=members, resembling=(), probability=0.9)] if places else []
    return SimpleNamespace(effects=causes, located=located, catalogue=catalogue, blunders=())


def test_a_set_that_holds_the_cause_names_it(scope: Scope) -> None:
    one = next(d for d in (drawn(scope, EFFECT, k) for k in range(99)) if "axis_tilt" in d.cause)
    assert judge_claims(verdict_of(("axis_tilt.x.y", one.cause)), one)[0] == ["axis_tilt.x.y"]
    assert judge_claims(verdict_of(("rail_bow.x.y",)), one) == ([], [], ["rail_bow.x.y"])
    assert judge_claims(verdict_of(places=("rail.x.y/travel",)), one)[2] == ["rail.x.y/travel"]
    assert judge_claims(verdict_of(("axis_tilt.common",)), one)[2] == ["axis_tilt.common"]
    assert judge_claims(verdict_of(("axis_tilt",)), one)[0] == [
        "axis_tilt"
    ]  # the block that holds it


def test_a_place_is_located_by_its_class(scope: Scope) -> None:
    one = drawn(scope, OUTSIDE)
    assert judge_claims(verdict_of(places=("bar.x.1/approach", one.cause)), one)[1]
    assert judge_claims(verdict_of(("axis_tilt.x.y",)), one)[2] == ["axis_tilt.x.y"]


# --- the run --------------------------------------------------------------------------------------


def told(found: Rehearsal) -> str:
    assert not any(t.failed for t in found.campaigns), found
    return str(found)


@pytest.fixture(scope="module")
def alone() -> Rehearsal:
    return og.rehearse(og.Machine.load(MACHINE), "standard", 3, seed=2)


@pytest.mark.thorough
def test_campaigns_are_the_same_whatever_the_workers(alone: Rehearsal) -> None:
    two = og.rehearse(og.Machine.load(MACHINE), "standard", 2, seed=2, jobs=2)
    assert [encoded(replace(t, seconds=0.0)) for t in two.campaigns] == [
        encoded(replace(t, seconds=0.0)) for t in alone.campaigns[:2]
    ]


@pytest.mark.parametrize("jobs", [5, -1])
def test_no_more_processes_than_campaigns(jobs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    import joblib

    class Ended(Exception):
        pass

    def parallel(n_jobs: int, **_: object) -> None:
        assert n_jobs == 1
        raise Ended

    monkeypatch.setattr(joblib, "Parallel", parallel)
    with pytest.raises(Ended):
        og.rehearse(og.Machine.load(MACHINE), "standard", 1, jobs=jobs)


@pytest.mark.thorough
def test_a_dask_cluster_gives_the_same_table(alone: Rehearsal) -> None:
    distributed = pytest.importorskip("dask.distributed")
    from joblib import parallel_config

    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with (
        distributed.LocalCluster(**options) as cluster,
        distributed.Client(cluster),
        parallel_config(backend="dask"),
    ):
        found = og.rehearse(og.Machine.load(MACHINE), "standard", 3, seed=2)
    assert told(found) == told(alone)


@pytest.mark.thorough
def test_a_stopped_rehearsal_goes_on(alone: Rehearsal, tmp_path: Path) -> None:
    machine, out = og.Machine.load(MACHINE), tmp_path / "out"
    og.rehearse(machine, "standard", 2, seed=2, out=out)
    kept = out / "campaigns.jsonl"
    kept.write_bytes(kept.read_bytes()[:-20])  # killed while writing the last line
    steps: list[str] = []
    found = og.rehearse(
        machine, "standard", 3, seed=2, out=out, progress=lambda s: steps.append(str(s))
    )
    assert told(found) == told(alone)
    assert "campaign 1 of 3" in steps
    assert "campaign 0 of 3" not in steps
    assert len(kept.read_text().splitlines()) == 4
    for change in ({"seed": 3}, {"sheet": "sweep"}, {"machine": og.Machine.nominal()}):
        request: dict[str, Any] = {"machine": machine, "sheet": "standard", "seed": 2} | change
        with pytest.raises(og.FileError, match="another rehearsal, as the"):
            og.rehearse(**request, campaigns=1, out=out)


def test_a_failed_campaign_counts_and_is_shown(scope: Scope, monkeypatch: Any) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise og.SolverError("it does not settle")

    monkeypatch.setattr("orthoglide.rehearsal.outcome.compute_outcome", fail)
    tried = run_campaign(scope, 0, 0)
    assert tried.failed == "SolverError: it does not settle"
    assert not tried.missed
    found = Rehearsal("mine", 36, 0, (tried,))
    assert found.columns["failed"][KINDS.index(EFFECT)] == 1
    assert "failed, SolverError: it does not settle" in str(found)
    assert decoded(Outcome, json.loads(json.dumps(encoded(tried))), {}).failed == tried.failed


def test_the_result_is_a_table(alone: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = alone.to_frame()
    assert list(frame.index) == [0, 1, 2]
    assert frame.after_mm.notna().all()
    assert alone.columns["campaigns"] == [sum(k is t for t in KIND_SEQUENCE[:3]) for k in KINDS]
    assert "<table>" in alone._repr_html_()
    monkeypatch.setenv("COLUMNS", "60")
    assert max(map(len, str(alone).splitlines())) <= 60
    assert {len(alone.of(k)) for k in KINDS} == {0, 1}


# --- on the command line --------------------------------------------------------------------------


def refused(*arguments: str) -> str:
    result = run("rehearse", *arguments)
    assert result.exit_code == 2, result.output
    return result.output


def test_what_cannot_be_rehearsed_is_refused(tmp_path: Path) -> None:
    (tmp_path / "theirs").write_text("x")
    assert "holds no earlier rehearsal" in refused("--out", str(tmp_path))
    (tmp_path / "campaigns.jsonl").write_text("[]\n")
    assert "holds no campaigns of a rehearsal" in refused("--out", str(tmp_path))


def test_the_command_keeps_and_prints(tmp_path: Path) -> None:
    og.write_campaign(og.protocol("standard"), tmp_path / "sheet.csv")
    line = [
        "rehearse", "--sheet", str(tmp_path / "sheet.csv"), "--campaigns", "1", "--jobs", "1",
        "--out", str(tmp_path / "out"),
    ]  # fmt: skip
    result = run(*line)
    assert result.exit_code == 0, result.output
    assert "what is wrong" in result.stdout
    assert (tmp_path / "out" / "rehearsal.txt").read_text() == result.stdout
    assert run(*line).stdout == result.stdout  # nothing is left to do
    kept = tmp_path / "out" / "campaigns.jsonl"
    longer = json.loads(kept.read_text().splitlines()[-1]) | {"number": 4}
    with kept.open("a") as file:
        file.write(json.dumps(longer) + "\n")
    fewer = run(*line)  # a longer table is not replaced
    assert fewer.exit_code == 2
    assert "ask for 5 or more" in " ".join(fewer.output.split())
    assert (tmp_path / "out" / "rehearsal.txt").read_text() == result.stdout
    kept.write_text("".join(kept.read_text().splitlines(True)[:-1]))
    short = run(*line, "--quiet").stdout.strip()
    assert re.fullmatch(r"campaigns 1(, (named|located|missed|false|failed) [01]){5}", short)


@pytest.mark.thorough
def test_a_process_that_is_ended_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("orthoglide.rehearsal.rehearsing.run_campaign", _end_this_process)
    with pytest.raises(og.NumericsError, match="ended from outside"):
        og.rehearse(og.Machine.load(MACHINE), "standard", 2, jobs=2, out=tmp_path / "out")


def _end_this_process(*_: Any) -> None:
    os._exit(1)


# --- instruments at the tool ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def delta() -> og.Machine:
    return og.Machine(import_printer(DATA / "electrocally.cfg").machine)


def test_a_sheet_and_what_one_owns_exclude_each_other(delta: og.Machine) -> None:
    with pytest.raises(og.InputError, match="exclude each other"):
        og.rehearse(delta, instrument_sheet(delta, "tcp"), owns=["plate"], campaigns=1)
