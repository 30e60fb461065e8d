"""What the budget says that mending gains, against what mending the machine gains.

    python benchmarks/gains.py --machines 40 --jobs 2 --cache gains.jsonl

Machines are simulated by the tests' own (`tests/rig.py`): everything is off by 0.01, 0.03 or 0.1 of
its tolerance in the rig's machine file, and one to three effects stand out at 0.5 to 2. The loop is
closed on a machine's readings; each item of its error budget is then mended on the machine itself:
*repaired*, its parameters set to zero, or *compensated*, the values found taken away. The error is
the mean over the workspace that the best zeros, lengths and translation leave. A run goes on where
it stopped, from the cache.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac, public, whole_machines
from benchmarks.independent import BASE
from benchmarks.public import campaign, machine
from benchmarks.runs import Record, Table, run_all
from tests import rig_campaigns as rc
from tests.rig import Rig, parameter_names

EFFECTS = ("axis_tilt", "axis_offset", "rail_bow", "encoder_scale", "screw_error", "bar_mismatch",
           "parallelogram_width")  # fmt: skip
"""What moves the tool past the best zeros and lengths."""

SHARES = (0.01, 0.03, 0.1)
"""Of their tolerances by which everything is off."""

SIZES = (0.5, 2.0)
"""Tolerances of what stands out."""

COUNTS = (1, 2, 3)
PROTOCOLS = ("sweep", "two-gauges")
STEP = 1e-6  # metres, of derivatives
GRID = 5  # commands along each axis of the workspace
_EVEN = 1 / 1.2207440846 ** np.arange(1, 4)
"""Steps of a sequence that fills a cube evenly (Roberts 2018, by the root of x^4 = x + 1)."""

Case = tuple[int, str, int]
Array = np.ndarray


def rig_of(case: Case, seed: int) -> tuple[Rig, np.random.Generator]:
    """A machine of which everything is off by a share, and that many effects stand out."""
    count, _, number = case
    rng = np.random.default_rng([seed, number])
    rig = whole_machines.rig_of(SHARES[number // 2 % len(SHARES)], rng)
    for family in rng.choice(EFFECTS, count, replace=False).tolist():
        cause = ac.effect(family, rng)
        rig = cause.added_to(rig, float(rng.uniform(*SIZES)))
    return rig, rng


def workspace() -> Array:
    """Return commands over the stroke at three phases of the screws' turns ``(n, 3)``, metres."""
    rig = Rig()
    travel, spacing = np.linspace(*rig.stroke, GRID, retstep=True)
    grid = np.stack(np.meshgrid(travel, travel, travel, indexing="ij"), axis=-1).reshape(-1, 3)
    third = min(rig.screw_pitch, float(spacing)) / 3
    phase = np.floor(3 * ((0.5 + np.arange(len(grid))[:, None] * _EVEN) % 1.0))
    low, high = (np.abs(grid - end) < third for end in (travel[0], travel[-1]))
    return np.asarray(rig.L + grid + third * (phase - 1 + low - high))


class Tool:
    """The tool's error of a rig that the best zeros, lengths and translation leave."""

    def __init__(self) -> None:
        self.commands = workspace()

    def _shape(self, rig: Rig) -> Array:
        p = rig.pose(self.commands).p
        return np.asarray((p - p.mean(axis=0)).ravel())

    def error(self, rig: Rig) -> float:
        """Mean over the workspace, millimetres: zeros and lengths by Gauss and Newton."""
        settings = np.array([rig.error(n) for n in BASE])
        for _ in range(3):
            here = Rig(errors=dict(zip(BASE, settings.tolist(), strict=True)))
            now = self._shape(here)
            slopes = [self._shape(here.with_errors({n: here.error(n) + STEP})) - now for n in BASE]
            apart = self._shape(rig) - now
            found = np.linalg.lstsq(np.transpose(slopes) / STEP, apart, rcond=1e-6)[0]
            settings = settings + found
        left = (apart - np.transpose(slopes) / STEP @ found).reshape(-1, 3)
        return 1e3 * float(np.linalg.norm(left, axis=1).mean())


def run(case: Case, seed: int) -> Record:
    """One machine: gains predicted and realised."""
    began, (rig, rng) = time.perf_counter(), rig_of(case, seed)
    rows = rc.simulate(rig, rc.protocol_rows(case[1]), rng)
    record: Record = {"case": list(case), "seed": seed}
    try:
        verdict = og.close_loop([campaign(rows)], machine())
    except og.OrthoglideError as error:
        return record | {"word": "error", "message": str(error)}
    found, tool = {n: v for n, (v, _) in public.calibrated_of(verdict).items()}, Tool()
    result = public.verdict_of(verdict)
    now, named = tool.error(rig), {e["name"] for e in result["effects"]}
    mended = [
        {
            "cause": item["cause"],
            "named": item["cause"] in named,
            "said": {
                "repaired": [item["gain_mm"], item["gain_sigma_mm"]],
                "compensated": [item["compensated_mm"], item["compensated_sigma_mm"]],
            },
            "repaired": now - tool.error(rig.with_errors(dict.fromkeys(_on_rig(item), 0.0))),
            "compensated": now
            - tool.error(
                rig.with_errors({n: rig.error(n) - found.get(n, 0.0) for n in _on_rig(item)})
            ),
        }
        for item in result["budget"]
    ]
    seconds = round(time.perf_counter() - began, 2)
    return record | {"word": result["verdict"], "error": now, "items": mended, "seconds": seconds}


def _on_rig(item: Record) -> list[str]:
    """Its parameters that a rig has: those of places it has not."""
    return sorted(set(item["members"]) & set(parameter_names()))


def tables(found: Sequence[Record]) -> list[Table]:
    """The table; gains in mm."""
    lines = [["mended", "", "items", "predicted", "realised", "ratio", "within 1.96 sigma"]]
    of_rig = {n.partition(".")[0] for n in parameter_names()}  # a place cannot be mended on a rig
    items = [
        item
        for r in found
        for item in r.get("items", ())
        if item["cause"].partition(".")[0] in of_rig
    ]
    for how in ("repaired", "compensated"):
        for what, named in (("causes named", {True}), ("the rest of an effect", {False}),
                            ("all", {True, False})):  # fmt: skip
            chosen = [i for i in items if i["named"] in named]
            if not chosen:
                continue
            gain, sigma = np.transpose([i["said"][how] for i in chosen])
            real = np.array([i[how] for i in chosen])
            within = np.abs(gain - real) <= 1.96 * sigma + LEAST
            lines.append([
                how, what, str(len(chosen)), f"{gain.mean():.4f}", f"{real.mean():.4f}",
                f"{gain.mean() / real.mean():.3f}", f"{100 * within.mean():.1f} %",
            ])  # fmt: skip
    return [Table("", "", lines)]


LEAST = 5e-4
"""Millimetres: gains that differ by less, a tenth of a reading's noise, are the same."""


def cases(machines: int) -> list[Case]:
    """Return so many machines; sheets alternate, then shares, then counts of effects."""
    return [(COUNTS[k // 6 % len(COUNTS)], PROTOCOLS[k % 2], k) for k in range(machines)]


if __name__ == "__main__":
    run_all(__doc__, cases, run, tables, machines=40)
