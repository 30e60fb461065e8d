# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
"""Run the golden cases and print what differs; with ``--write`` also keep it.

    python -m tests.golden [CASE ...]            differences, and the time of each case
    python -m tests.golden --write [CASE ...]    the same, and new golden files

A commit that changes a golden file says in its message which differences it accepts and why.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import tempfile
import time
from pathlib import Path

from tests.golden.compare import beyond, differences
from tests.golden.results import Case, cases, result_of, text


def main() -> int:
    """Run the cases asked for, and return 1 where one differs beyond its tolerances."""
    names = [case.name for case in cases()]
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("case", nargs="*", metavar="CASE", help=", ".join(names))
    parser.add_argument("--write", action="store_true", help="keep the new results")
    given = parser.parse_args()
    if unknown := set(given.case) - set(names):
        parser.error(f"no case is called {', '.join(sorted(unknown))}")
    start, differing = time.process_time(), 0
    for case in cases():
        if not given.case or case.name in given.case:
            differing += not report(case, given.write)
    print(f"{time.process_time() - start:.1f} s in all; {differing} differ")
    return int(differing > 0)


def report(case: Case, write: bool) -> bool:
    """Run a case, print its time and differences; whether it is within its tolerances."""
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        now = result_of(case, Path(folder))
    took = f"{time.process_time() - start:5.1f} s{' (thorough)' * case.thorough}"
    if not case.file.exists():
        print(f"{case.name:28} {took}  new: {now['verdict']}", flush=True)
        same = False
    else:
        found = differences(case.golden, now, case.tolerance)
        wrong = beyond(found)
        said = f"{len(wrong)} beyond tolerance" if wrong else "within tolerance"
        print(f"{case.name:28} {took}  {now['verdict']}, {said}", flush=True)
        for one in wrong or found[:1]:
            print(f"    {one}")
        same = not wrong
    if write:
        case.file.write_text(text(now), encoding="utf-8")
    return same


if __name__ == "__main__":
    raise SystemExit(main())
