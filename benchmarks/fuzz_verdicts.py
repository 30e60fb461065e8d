"""Verdicts on campaigns of known machines, most with readings moved: is any *adequate* false?

The machines are the tests' independent one with offsets, lengths and a little of everything else.
*Adequate* is false where a reading that was moved stands more than five of the stated sigmas from
what the fit says of it, and nothing was said of it: no fault, no remark. How far the tool is off
the calibrated machine is held against the 95 % radius that is stated, place by place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import orthoglide as og
from benchmarks import public
from benchmarks.runs import Table
from tests import rig_campaigns as rc
from tests.rig import LEGS, Array, Rig

FIVE = 5.0
"""Sigmas beyond which a reading that was moved must be spoken of."""

_NOISE, _STEP = 5e-6, 1e-5
_RIG = Path(__file__).parents[1] / "tests" / "data" / "rig" / "machine.toml"
_SAID = ("slip", "lack_of_fit", "copies", "campaign")


@dataclass(frozen=True)
class Judged:
    """What became of one campaign.

    Attributes:
        number: that it was drawn from.
        kind: how readings were moved.
        word: of the verdict; ``refused`` where there is none.
        told: whether anything is said of the readings.
        moved: largest change of a reading, sigmas of the noise put in.
        off: largest distance of a moved reading from the fit, stated sigmas; 0 if it was set aside.
        beyond: share of the places where the tool is off by more than the stated radius.
    """

    number: int
    kind: str
    word: str
    told: bool = True
    moved: float = 0.0
    off: float = 0.0
    beyond: float = float("nan")

    @property
    def false(self) -> bool:
        """Whether *adequate* is said of readings that cannot be right, and no word more."""
        return self.word == "adequate" and not self.told and self.off > FIVE


_Move = Callable[[np.random.Generator, Array, Array, float], None]


def _one(rng: np.random.Generator, reading: Array, own: Array, size: float) -> None:
    reading[rng.choice(own)] += size


def _several(rng: np.random.Generator, reading: Array, own: Array, size: float) -> None:
    reading[rng.choice(len(reading), rng.integers(2, 6), replace=False)] += size


def _exchanged(rng: np.random.Generator, reading: Array, own: Array, size: float) -> None:
    two = rng.choice(len(reading), 2, replace=False)
    reading[two] = reading[two[::-1]]


def _shuffled(rng: np.random.Generator, reading: Array, own: Array, size: float) -> None:
    some = rng.choice(own, min(len(own), rng.integers(3, 9)), replace=False)
    reading[some] = reading[rng.permutation(some)]


def _stepped(rng: np.random.Generator, reading: Array, own: Array, size: float) -> None:
    reading[own[rng.integers(1, len(own)) :]] += size


def _stuck(rng: np.random.Generator, reading: Array, own: Array, size: float) -> None:
    first = rng.integers(0, len(own) - 3)
    reading[own[first:]] = reading[own[first]]


def _turned(rng: np.random.Generator, reading: Array, own: Array, size: float) -> None:
    reading[own] = 2 * reading[own[0]] - reading[own]


def _magnified(rng: np.random.Generator, reading: Array, own: Array, size: float) -> None:
    reading[own] *= 1 + 20 * size


KINDS: dict[str, _Move | None] = {
    "as read": None, "one": _one, "several": _several, "exchanged": _exchanged,
    "shuffled": _shuffled, "a step": _stepped, "stuck": _stuck, "turned": _turned,
    "magnified": _magnified,
}  # fmt: skip


@cache
def _machine(declared: bool) -> og.Machine:
    return og.Machine.load(_RIG) if declared else og.Machine.nominal()


def judged(number: int) -> Judged:
    """Draw a machine and its campaign, move readings, and judge the verdict."""
    rng, kind = np.random.default_rng([number, 9]), list(KINDS)[number % len(KINDS)]
    sheet, judge = ("standard", "sweep")[number // 2 % 2], _machine(number % 2 == 0)
    rows = rc.protocol_rows(sheet)
    setups = list(dict.fromkeys(r["setup"] for r in rows))
    errors = {f"joint_offset.{leg}": float(rng.normal(0, 1e-3)) for leg in LEGS}
    errors |= {f"leg_length.{leg}": float(rng.normal(0, 5e-5)) for leg in LEGS}
    rig = Rig().with_errors(errors).with_background(rng, 0.02, setups)
    rows = rc.simulate(rig, rows, rng, noise=_NOISE, resolution=_STEP)
    before = np.array([r["reading_mm"] for r in rows]) * 1e-3
    after, move = before.copy(), KINDS[kind]
    sigma = float(np.hypot(_NOISE, _STEP / np.sqrt(12)))
    size = sigma * float(np.exp(rng.uniform(np.log(6), np.log(300)))) * rng.choice([-1.0, 1.0])
    if move is not None:
        setup = rng.choice(setups)
        move(rng, after, np.flatnonzero([r["setup"] == setup for r in rows]), size)
    shown = np.round(after / _STEP) * _STEP
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    columns["reading_mm"] = [f"{v * 1e3:.2f}" for v in shown]
    moved = np.abs(shown - before) > _STEP / 2
    most = float(np.max(np.abs(shown - before))) / sigma
    try:
        campaign = og.Campaign.from_frame(columns, name="moved", machine_file=judge.spec)
        verdict = og.close_loop(campaign, judge)
    except og.OrthoglideError:
        return Judged(number, kind, "refused", moved=most)
    told = bool(verdict.blunders) or any(w.kind in _SAID for w in verdict.after.warnings)
    beyond = _beyond(verdict, rig) if verdict.word == "adequate" else float("nan")
    return Judged(number, kind, verdict.word, told, most, _off(verdict, moved), beyond)


def _off(verdict: og.Verdict, moved: Array) -> float:
    """Largest residual of the rows that were moved and not set aside, stated sigmas."""
    aside = [row for fault in verdict.blunders for _, row in fault.rows_in_request]
    kept = np.asarray(moved, dtype=bool).copy()
    kept[aside] = False
    times = np.abs(public.residual_sigmas(verdict))
    # Faulty rows are gone from the problem, or weigh nothing there.
    return float(times[kept].max(initial=0.0)) if len(times) == len(kept) else 0.0


def _beyond(verdict: og.Verdict, rig: Rig) -> float:
    """Share of the places where the tool's shape is off by more than its stated radius."""
    commands, p, radius = public.tool_map(verdict)
    apart = rig.pose(commands, np.zeros_like(commands)).p - p
    off = np.linalg.norm(apart - apart.mean(axis=0), axis=1)
    return float(np.mean(off > radius))


def report(found: Iterable[Judged]) -> Table:
    """The counts."""
    several = list(found)
    rows = [["readings", "verdicts", "adequate", "told", "refused", "false"]]
    for kind in KINDS:
        own = [j for j in several if j.kind == kind]
        adequate = [j for j in own if j.word == "adequate"]
        counts = (len(own), len(adequate), sum(j.told for j in adequate),
                  sum(j.word == "refused" for j in own), sum(j.false for j in own))  # fmt: skip
        rows.append([kind, *map(str, counts)])
    shares = [j.beyond for j in several if np.isfinite(j.beyond)]
    note = (
        f"The tool's shape is beyond its 95 % radius at {100 * np.mean(shares or [0.0]):.1f} % of "
        f"the places of {len(shares)} adequate machines."
    )
    return Table("", note, rows)
