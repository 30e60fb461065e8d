"""One cause larger than the rest, on machines on which everything is wrong: is it named?

    python -m benchmarks.stands_out --machines 60 --jobs 2 --cache stands-out.jsonl

Every effect that moves the tool is off by ``f`` of its tolerance, and one of them by five or ten
times that. *Oracle*: what is named by who is told all but which cause it is; *as they state*:
the mean probability that the sets give themselves; *or say what is so*: sets that hold the cause,
or name another error that the machine has, to half of its size. A run goes on where it stopped,
from the cache.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from benchmarks import attribution_cases as ac
from benchmarks.attribution_asked import share as share_of
from benchmarks.attribution_cases import Cause
from benchmarks.attribution_run import campaign, machine
from benchmarks.whole_machines import FAMILIES, SHARES, Record, arguments, records, rig_of
from orthoglide.closing import close_loop
from orthoglide.errors import OrthoglideError
from orthoglide.posterior.causes import Explanation
from orthoglide.posterior.everything import FullPosterior
from orthoglide.posterior.linear import Basis, Scale
from orthoglide.posterior.outstanding import CREDIBLE, MOST, NAMED
from orthoglide.rehearsal.outcome import is_cause
from tests import rig_campaigns as rc
from tests.rig import Rig

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

    def right(name: str, parameters: Sequence[str]) -> bool:
        return bool(is_cause(name, parameters, cause.name, family, []))

    posterior = verdict.posterior
    assert posterior is not None
    candidates = [right(c.name, c.parameters) for c in posterior.about.candidates]
    scale = Scale(Basis(posterior.mixture.linear, 1e-3, 0.0), share)
    return record | {
        "word": verdict.word,
        "seen": seen(posterior, scale, cause, size),
        "sets": [[right(e.name, e.parameters) for e in f.explanations] for f in verdict.effects],
        "so": [any(is_so(e, posterior, rig) for e in f.explanations) for f in verdict.effects],
        "stated": [sum(e.probability for e in f.explanations) for f in verdict.effects],
        "oracle": oracle(scale, size, candidates),
        "located": [f.name for f in verdict.located],
    }


def is_so(told: Explanation, posterior: FullPosterior, rig: Rig) -> bool:
    """Whether the machine is off by what is told, to half of it: it need not be by the cause that
    was made larger, where everything is off by a share of its tolerance.
    """
    each = (zip(c.parameters, c.weights, strict=True) for c in posterior.about.candidates)
    weights = dict(chain.from_iterable(each))
    said: dict[str, float] = {}
    for parameter, value in told.values.items():
        # The twin of a candidate is none: a parameter of its own.
        for name, weight in weights.get(parameter, {parameter: 1.0}).items():
            plain = name.partition("@")[0]
            said[plain] = said.get(plain, 0.0) + weight * value
    apart = [value - rig.error(name) for name, value in said.items()]
    return bool(np.linalg.norm(apart) <= np.linalg.norm(list(said.values())) / 2)


def seen(posterior: FullPosterior, scale: Scale, cause: Cause, size: float) -> float:
    """What a cause shows past noise and the background of all others, sigmas."""
    index = {name: k for k, name in enumerate(posterior.about.problem.names)}
    shown = np.zeros(len(scale.residual))
    for name, value in cause.errors.items():
        if name in index:
            shown += scale.columns[:, index[name]] * value / machine().tolerance(name)
    square = float(shown @ shown)
    return float(size * np.sqrt(square / max(1 - scale.share**2 * square, 1e-9)))


def oracle(scale: Scale, size: float, right: Sequence[bool]) -> bool:
    """Whether the cause would be in a set of at most twenty, by who is told everything but which:
    how large the background is, and that one cause of this size stands out of it, or none, at
    even odds.
    """
    groups = scale.basis.linear.groups[: len(right)]
    logs = [0.0]
    for group in groups:
        columns = size * scale.columns[:, group.places] @ group.weights
        inner = np.eye(group.size) + columns.T @ columns
        along = columns.T @ scale.residual
        logs.append(
            0.5 * float(along @ np.linalg.solve(inner, along))
            - 0.5 * float(np.linalg.slogdet(inner)[1])
            - float(np.log(len(groups)))
        )
    weights = np.exp(np.array(logs) - max(logs))
    nothing, *each = weights / weights.sum()
    order = np.argsort(each)[::-1]
    count = int(np.searchsorted(np.cumsum(np.array(each)[order]), CREDIBLE * (1 - nothing))) + 1
    said = 1 - nothing >= NAMED and count <= MOST
    return bool(said and any(right[k] for k in order[:count]))


def table(found: Sequence[Record]) -> Iterator[str]:
    """The table, in Markdown."""
    yield (
        "| f, and the cause | n | it is clear | named, alone or in a set | oracle "
        "| first and alone | sets that hold it | or say what is so | as they state "
        "| size of its set | places said |"
    )
    yield "|---" * 11 + "|"
    told = [r for r in found if "sets" in r]
    for times in TIMES:
        for share in SHARES[1:]:
            rows = [r for r in told if (r["case"][0], r["case"][3]) == (share, times)]
            yield f"| {share:g}, {times} times that | {_row(rows)} |"
    for times in TIMES:
        for protocol in ac.PROTOCOLS:
            rows = [r for r in told if (r["case"][1], r["case"][3]) == (protocol, times)]
            yield f"| {protocol}, {times} times | {_row(rows)} |"
    yield f"| all | {_row(told)} |"


def _row(rows: Sequence[Record]) -> str:
    clear = [r for r in rows if r["seen"] >= CLEAR]
    sets = [s for r in rows for s in r["sets"]]
    so = [(any(s), true) for r in rows for s, true in zip(r["sets"], r["so"], strict=True)]
    stated = [p for r in rows for p in r["stated"]]
    sizes = [len(s) for s in sets if any(s)]
    return " | ".join(
        (
            str(len(rows)),
            str(len(clear)),
            share_of(clear, lambda r: any(map(any, r["sets"]))),
            share_of(clear, lambda r: r["oracle"]),
            share_of(clear, lambda r: r["sets"][:1] == [[True]]),
            share_of(sets, any),
            share_of(so, any),
            f"{100 * np.mean(stated):.1f} %" if stated else "-",
            f"{np.mean(sizes):.2f}" if sizes else "-",
            str(sum(len(r["located"]) for r in rows)),
        )
    )


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
