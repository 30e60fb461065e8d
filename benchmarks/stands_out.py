"""One cause larger than the rest, on machines on which everything is wrong: is it named?

    python -m benchmarks.stands_out --machines 60 --jobs 2 --cache stands-out.jsonl

Every effect that moves the tool is off by ``f`` of its tolerance, and one of them by five or ten
times that. A run goes on where it stopped, from the cache.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks import attribution_cases as ac
from benchmarks.attribution_cases import Cause
from benchmarks.attribution_run import campaign, machine
from benchmarks.whole_machines import FAMILIES, SHARES, Record, arguments, records, rig_of
from orthoglide.closing import Verdict, close_loop
from orthoglide.errors import OrthoglideError
from orthoglide.posterior.linear import Basis, Scale
from orthoglide.rehearsal.scoring import is_cause
from tests import rig_campaigns as rc

TIMES = (5, 10)
"""The cause over the background."""

CLEAR = 5.0
"""Sigmas by which a cause should be named: what it shows, past noise and background."""


def run(case: tuple[float, str, int, int], seed: int) -> Record:
    """One machine: what is larger than the rest, and what is said of it."""
    share, protocol, number, times = case
    rng = np.random.default_rng([seed, round(1000 * share), number, times])
    rows = rc.protocol_rows(protocol)
    family = str(rng.choice(FAMILIES))
    setups = list(dict.fromkeys(row["setup"] for row in rows))
    cause = ac.effect(family, machine().tolerance(family), setups, rng, shaped=False)
    size = times * share
    rig = rig_of(share, rng).with_errors({n: size * v for n, v in cause.errors.items()})
    record: Record = {"case": list(case), "seed": seed, "cause": cause.name}
    try:
        verdict = close_loop([campaign(rc.simulate(rig, rows, rng))], machine())
    except OrthoglideError as error:
        return record | {"word": "error", "message": str(error)}
    sets = [
        [bool(is_cause(e.name, e.parameters, cause.name, family, [])) for e in found.explanations]
        for found in verdict.effects
    ]
    return record | {
        "word": verdict.word,
        "seen": seen(verdict, cause, share, size),
        "sets": sets,
        "located": [f.name for f in verdict.located],
    }


def seen(verdict: Verdict, cause: Cause, share: float, size: float) -> float:
    """What a cause shows past noise and the background of all others, sigmas."""
    assert verdict.posterior is not None
    linear, about = verdict.posterior.mixture.linear, verdict.posterior.about
    index = {name: k for k, name in enumerate(about.problem.names)}
    scale = Scale(Basis(linear, 1e-3, 0.0), share)
    shown = np.zeros(len(scale.residual))
    for name, value in cause.errors.items():
        if name in index:
            shown += scale.columns[:, index[name]] * value / machine().tolerance(name)
    square = float(shown @ shown)
    return float(size * np.sqrt(square / max(1 - share**2 * square, 1e-9)))


def table(found: Sequence[Record]) -> Iterator[str]:
    """The table, in Markdown."""
    yield (
        "| f, and the cause | n | it is clear | named, alone or in a set | first and alone "
        "| sets that hold it | size of its set | places said |"
    )
    yield "|---" * 8 + "|"
    told = [r for r in found if "sets" in r]
    for times in TIMES:
        for share in SHARES[1:]:
            rows = [r for r in told if (r["case"][0], r["case"][3]) == (share, times)]
            yield f"| {share:g}, {times} times that | {_row(rows)} |"
    yield f"| all | {_row(told)} |"


def _row(rows: Sequence[Record]) -> str:
    clear = [r for r in rows if r["seen"] >= CLEAR]
    named = [r for r in clear if any(map(any, r["sets"]))]
    alone = [r for r in clear if r["sets"] and r["sets"][0] == [True]]
    sets = [s for r in rows for s in r["sets"]]
    sizes = [len(s) for s in sets if any(s)]
    return " | ".join(
        (
            str(len(rows)),
            str(len(clear)),
            _of(len(named), len(clear)),
            _of(len(alone), len(clear)),
            _of(sum(map(any, sets)), len(sets)),
            f"{np.mean(sizes):.2f}" if sizes else "-",
            str(sum(len(r["located"]) for r in rows)),
        )
    )


def _of(hits: int, count: int) -> str:
    return f"{100 * hits / count:.1f} % ({hits}/{count})" if count else "-"


def main() -> None:
    options = arguments(__doc__).parse_args()
    every = [
        (share, ac.PROTOCOLS[k % len(ac.PROTOCOLS)], k, times)
        for k in range(options.machines)
        for share in SHARES[1:]
        for times in TIMES
    ]
    began = time.perf_counter()
    found = list(records(every, options.seed, options.jobs, options.cache, run))
    print("\n".join(table(found)))
    print(f"\n{len(found)} machines, {time.perf_counter() - began:.0f} s.")


if __name__ == "__main__":
    main()
