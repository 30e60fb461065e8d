"""Time and memory of `close_loop` by the number of readings: 500 stations, or all different.

python benchmarks/scale.py [ROWS] [STATIONS]      one size; 0 stations: all differ
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import orthoglide as og

SIZES = ((2_520, 504), (20_160, 504), (100_000, 504), (100_000, 0))


def sheet_of(rows: int, stations: int) -> og.Campaign:
    """Six setups, each with its share of stations along the leg's axis, visited in rounds."""
    base = og.protocol("sweep")
    per = (stations or rows) // 6
    rounds = max(rows // (6 * per), 1)
    travel = np.tile(np.linspace(-0.1, 0.06, per), 6 * rounds)
    setup = np.repeat(np.arange(6), per * rounds)
    leg, length = np.array([s.leg for s in base.setups])[setup], og.Machine.nominal().geometry.L
    command = np.repeat(np.sqrt(length**2 - travel**2)[:, None], 3, axis=1)
    command[np.arange(len(setup)), leg] = length + travel
    n = len(setup)
    return og.Campaign(
        base.name, base.setups, setup, command=np.round(command, 9), approach=np.ones((n, 3)),
        repeat=1 + np.tile(np.repeat(np.arange(rounds), per), 6),
        order=np.arange(n), reading=np.zeros(n), line=np.arange(2, n + 2),
    )  # fmt: skip


def main() -> None:
    if len(sys.argv) < 3:
        for size in SIZES:
            subprocess.check_call([sys.executable, __file__, *map(str, size)])
        return
    rows, stations = map(int, sys.argv[1:3])
    machine = og.Machine.nominal()
    truth = machine.with_parameters({"joint_offset.x": 5e-4, "joint_offset.y": -1.2e-3})
    campaign = og.simulate(truth, sheet_of(rows, stations), noise=5e-6, seed=1)
    start = time.process_time()
    verdict = og.close_loop(campaign, machine)
    seconds = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        verdict.report(Path(folder) / "report")
        size = (Path(folder) / "report" / "result.json").stat().st_size / 1e6
    report = time.process_time() - start - seconds
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    what = f"{stations} stations" if stations else "all stations different"
    print(f"{len(campaign)} readings, {what}: {verdict.word}, {seconds:.1f} s, {peak:.2f} GB")
    print(f"    report {report:.1f} s, result.json {size:.1f} MB")


if __name__ == "__main__":
    main()
