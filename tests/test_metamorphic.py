"""What must not matter does not, from the file to the words: the whole loop, twice."""

from __future__ import annotations

import csv
import io
import random
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

import orthoglide as og
from orthoglide.closing import RunOutcome
from orthoglide.effects.wording import cause_words
from tests.relabelling import relabelled
from tests.studied import studied

RIG = Path(__file__).parent / "data" / "rig"
CASES = ("rig-2", "rig-4")  # one explained, one ambiguous
TURN = {"x": "y", "y": "z", "z": "x"}

Row = dict[str, str]
Rows = list[Row]


@cache
def machine() -> og.Machine:
    return og.Machine.load(RIG / "machine.toml")


def recorded(case: str) -> Rows:
    """The rows of a campaign, with the approach that their order gives as columns of their own."""
    campaign = og.read_campaign(RIG / f"{case}.csv", machine().spec)
    with (RIG / f"{case}.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for row, approach in zip(rows, campaign.approach, strict=True):
        row |= {f"approach_{leg}": f"{way:+.0f}" for leg, way in zip("xyz", approach, strict=True)}
    return rows


def written(folder: Path, *files: Rows) -> list[Path]:
    """Files of readings."""
    paths = []
    for k, rows in enumerate(files):
        stream = io.StringIO(newline="")
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
        paths.append(folder / f"campaign{k}.csv")
        paths[-1].write_text(stream.getvalue())
    return paths


@cache
def plain(case: str) -> RunOutcome:
    """The outcome of the recorded rows as they are."""
    with tempfile.TemporaryDirectory() as folder:
        return studied(written(Path(folder), recorded(case)), machine())


def shuffled(rows: Rows) -> list[Rows]:
    """The rows in another order; column ``order`` still says when each was taken."""
    return [random.Random(1).sample(rows, len(rows))]


def renamed(rows: Rows) -> list[Rows]:
    """Setups with names of no meaning, in another alphabetical order."""
    names = {name: f"{k:03d} z" for k, name in enumerate(sorted({r["setup"] for r in rows})[::-1])}
    return [[row | {"setup": names[row["setup"]]} for row in rows]]


def set_elsewhere(rows: Rows) -> list[Rows]:
    """Every dial zeroed elsewhere."""
    names = sorted({row["setup"] for row in rows})
    datum = {name: 0.01 * random.Random(name).randrange(-500, 500) for name in names}
    moved = [f"{float(row['reading_mm']) + datum[row['setup']]:.4f}" for row in rows]
    return [[row | {"reading_mm": cell} for row, cell in zip(rows, moved, strict=True)]]


def mirrored(rows: Rows) -> list[Rows]:
    """Every other dial counts the other way."""
    turned = sorted({row["setup"] for row in rows})[::2]
    return [[
        row
        | {"direction": f"-{row['direction']}", "reading_mm": f"{-float(row['reading_mm']):.4f}"}
        if row["setup"] in turned else row for row in rows
    ]]  # fmt: skip


def all_at_once(rows: Rows) -> list[Rows]:
    """Everything of the above and of the below that leaves one file."""
    for change in (shuffled, renamed, set_elsewhere, mirrored, written_otherwise):
        (rows,) = change(rows)
    return [rows]


def in_two_files(rows: Rows) -> list[Rows]:
    """Half of the setups in a file of their own."""
    own = sorted({row["setup"] for row in rows})[::2]
    return [[r for r in rows if r["setup"] in own], [r for r in rows if r["setup"] not in own]]


def written_otherwise(rows: Rows) -> list[Rows]:
    """Columns in another order, digits that say nothing, a column of notes."""
    return [[
        {"notes": "=1+1", **{k: row[k] for k in reversed(row)},
         "reading_mm": f"{float(row['reading_mm']):+.9f}"} for row in rows
    ]]  # fmt: skip


CHANGES: tuple[Callable[[Rows], list[Rows]], ...] = (all_at_once, in_two_files)


def the_same(
    one: RunOutcome, other: RunOutcome, name: Callable[[str], str] = str, share: float = 0.0
) -> None:
    """Same words, and same numbers but for a share of their sigmas."""
    sigmas = one.machine.posterior.sigmas if one.machine.posterior is not None else {}
    assert other.word == one.word
    assert [e.name for e in other.effects] == [name(e.name) for e in one.effects]
    for before, after in zip(one.effects, other.effects, strict=True):
        rivals = {name(n) for n in before.indistinguishable_from}
        assert set(after.indistinguishable_from) == rivals
    assert set(other.values) == {name(n) for n in one.values}
    for parameter, value in one.values.items():
        slack = max(1e-9, share * sigmas.get(parameter, 0.0))
        assert other.values[name(parameter)] == pytest.approx(value, rel=1e-5, abs=slack)
    for stage in ("before", "after"):
        was, now = (getattr(v, stage).scores for v in (one, other))
        assert now.rms == pytest.approx(was.rms, rel=1e-5 + share)
        assert now.chi2 == pytest.approx(was.chi2, rel=1e-4 + share)
    assert len(other.blunders) == len(one.blunders)


@pytest.mark.thorough(except_for=["all_at_once-rig-2"])
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("change", CHANGES, ids=lambda f: f.__name__)
def test_what_says_nothing_of_the_machine_changes_nothing(
    change: Callable[[Rows], list[Rows]],
    case: str,
    tmp_path: Path,
) -> None:
    files = change(recorded(case))
    assert files != [recorded(case)]
    # What drifts or jumps with the recorded time begins with each file, and so does the way a drive
    # came: all have some weight in what is averaged.
    share = 0.05 if len(files) > 1 else 0.0
    the_same(plain(case), studied(written(tmp_path, *files), machine()), share=share)


@pytest.mark.thorough
@pytest.mark.parametrize("case", CASES)
def test_legs_with_other_names_are_found_under_them(case: str, tmp_path: Path) -> None:
    rows = []
    for row in recorded(case):
        new = dict(row)
        for leg, other in TURN.items():
            new[f"rho_{other}_mm"] = row[f"rho_{leg}_mm"]
            new[f"approach_{other}"] = row[f"approach_{leg}"]
        rows.append(new | {"leg": TURN[row["leg"]], "direction": TURN[row["direction"]]})
    turned = studied(written(tmp_path, rows), machine())
    catalogue = machine().catalogue

    def name(old: str) -> str:
        return str(relabelled(catalogue.parameter(old)))

    the_same(plain(case), turned, name)
    words = [cause_words(catalogue, e.name, turned.values) for e in turned.effects]
    assert all(words)
    for before, after in zip(plain(case).effects, turned.effects, strict=True):
        leg = catalogue.parameter(before.name).leg
        assert catalogue.parameter(after.name).leg == TURN[leg]


@pytest.mark.thorough
@pytest.mark.parametrize("case", CASES)
def test_the_seed_draws_and_does_not_decide(case: str) -> None:
    campaign = og.read_campaign(RIG / f"{case}.csv", machine().spec)
    for seed in (1, 2):
        the_same(plain(case), studied(campaign, machine(), seed=seed))
