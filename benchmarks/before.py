"""How fast the loops closed at an earlier commit, and how fast they do now, in one run.

    python benchmarks/before.py [COMMIT]

The commit, by default the one before machines of other layouts came in, is checked out into a
temporary folder. Two processes, of one thread each, close the loops of the same commands in turn,
so that a busy computer disturbs both alike; a row shows the median round.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROUNDS = 9
BEFORE_LAYOUTS = "d67ac2b^"
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def answer() -> None:
    """Time all ways once for every line that is read; microseconds a posture, as JSON.

    Only what both commits have is called.
    """
    import numpy as np

    from orthoglide.geometry import Geometry
    from orthoglide.mechanism import Mechanism
    from orthoglide.prediction import Model

    geometry = Geometry()
    model, one = Model(geometry, 0.02, compile=True), Mechanism(geometry, compile=True)
    rho = geometry.L + np.random.default_rng(0).uniform(*geometry.stroke, (4000, 3))
    moves = 3e-3 * np.random.default_rng(1).standard_normal((len(rho), 3, 10))
    batch, nominal = model.mechanism.batch, model.mechanism.nominal_batch
    general, rigid = model.mechanism.given(rho, moves), model.mechanism.given(rho)[:, :3].copy()
    few = rho[:200]
    near = [one.close(r + 1e-3) for r in few]
    ways = {
        "batch, relief and virtual joints": (len(rho), lambda: batch.close(general)),
        "batch, rigid legs": (len(rho), lambda: nominal.close(rigid)),
        "one posture, 1 mm off": (
            len(few), lambda: [one.close(r, guess=q) for r, q in zip(few, near, strict=True)],
        ),
        "one posture, cold": (len(few), lambda: [one.close(r) for r in few]),
        "one posture, cold, all virtual joints": (
            len(few), lambda: [one.close(r, m) for r, m in zip(few, moves[:200], strict=True)],
        ),
    }  # fmt: skip
    for _, call in ways.values():
        call()
    for _ in sys.stdin:
        took = {}
        for name, (count, call) in ways.items():
            began = time.perf_counter()
            call()
            took[name] = 1e6 * (time.perf_counter() - began) / count
        print(json.dumps(took), flush=True)


def _start(folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(Path(__file__).resolve()), "--answer"],
        env=os.environ | _THREADS | {"PYTHONPATH": str(folder)},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=folder,
    )  # fmt: skip


def _asked(process: subprocess.Popen[str]) -> dict[str, float]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    found: dict[str, float] = json.loads(process.stdout.readline())
    return found


def main() -> None:
    """Print microseconds of both, and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit", nargs="?", default=BEFORE_LAYOUTS)
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.answer:
        answer()
        return
    with tempfile.TemporaryDirectory() as made:
        archive = subprocess.run(
            ["git", "archive", asked.commit], cwd=ROOT, check=True, capture_output=True
        )
        subprocess.run(["tar", "-x", "-C", made], input=archive.stdout, check=True)
        with _start(Path(made)) as old, _start(ROOT) as new:
            rounds = [(_asked(old), _asked(new)) for _ in range(ROUNDS)]
    print(f"{'':40}{asked.commit:>12}         now   ratio")
    for name in rounds[0][0]:
        before, now = (sorted(r[k][name] for r in rounds)[ROUNDS // 2] for k in (0, 1))
        print(f"{name:40}{before:9.1f} us {now:8.1f} us {before / now:7.1f}")


if __name__ == "__main__":
    main()
