"""One cause larger than the rest, on machines on which everything is wrong: is it named?

    python -m benchmarks.stands_out --machines 60 --jobs 2 --cache stands-out.jsonl

Every effect that moves the tool is off by ``f`` of its tolerance, and one of them by five or ten
times that. *Oracle*: what is named by who is told all but which cause it is; *as they state*:
the mean probability that the sets give themselves; *or say what is so*: sets that hold the cause,
or name another error that the machine has, to half of its size. A run goes on where it stopped,
from the cache.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

import orthoglide as og
from benchmarks import attribution_cases as ac, independent, public, whole_machines
from benchmarks.attribution_asked import share as share_of
from benchmarks.independent import Sheet, Visible, is_cause, parameters, structured
from benchmarks.public import campaign, machine
from benchmarks.runs import Record, Table, run_all
from benchmarks.whole_machines import FAMILIES, SHARES, rig_of
from tests import rig_campaigns as rc
from tests.rig import Rig

TIMES = (5, 10)
"""The cause over the background."""

Case = tuple[float, str, int, int]

CLEAR = 5.0
"""Sigmas by which a cause should be named: what it shows, past noise and background."""

CREDIBLE, NAMED, MOST = 0.95, 0.9, 20
"""Of the documented claims: probability of a set, from which it is named, and its largest size."""


def run(case: Case, seed: int) -> Record:
    """One machine: what is larger than the rest, and what is said of it."""
    share, protocol, number, times = case
    rng = np.random.default_rng([seed, round(1000 * share), number, times])
    rows = rc.protocol_rows(protocol)
    family = str(rng.choice(FAMILIES))
    setups = list(dict.fromkeys(row["setup"] for row in rows))
    cause = ac.effect(family, rng, setups)
    size = times * share
    rig = rig_of(share, rng).with_errors({n: size * v for n, v in cause.errors.items()})
    record: Record = {"case": list(case), "seed": seed, "cause": cause.name}
    measured = rc.simulate(rig, rows, rng)
    try:
        verdict = og.close_loop([campaign(measured)], machine())
    except og.OrthoglideError as error:
        return record | {"word": "error", "message": str(error)}

    def right(name: str, parameters: Sequence[str]) -> bool:
        return bool(is_cause(name, parameters, cause.name, family))

    result = public.verdict_of(verdict)
    visible = beside(measured, share)
    size_of = {n: size * v / independent.tolerance(n) for n, v in cause.errors.items()}
    return record | {
        "word": result["verdict"],
        "seen": seen(visible, size_of, share),
        "sets": [[right(e["name"], e["parameters"]) for e in f["set"]] for f in result["effects"]],
        "so": [
            any(is_so(e["values_si"], setups, rig) for e in f["set"]) for f in result["effects"]
        ],
        "stated": [sum(e["probability"] for e in f["set"]) for f in result["effects"]],
        "oracle": oracle(visible, size, right),
        "located": [f["places"][0] for f in public.said(result)["located"]],
    }


def beside(measured: Sequence[rc.Row], share: float) -> Visible:
    """Return what causes show beside a background of all others at a share of their tolerance,
    linearised about the posterior mean that is given the share.
    """
    about = Rig(errors=whole_machines.oracle(measured, share))
    known = {n: share * independent.TOLERANCE[f] for f in FAMILIES for n in parameters(f)}
    return Visible(Sheet(measured), about, known)


def is_so(values: Mapping[str, float], setups: Sequence[str], rig: Rig) -> bool:
    """Whether the machine is off by what is stated, to half of it: it need not be by the cause that
    was made larger, where everything is off by a share of its tolerance.
    """
    stated: dict[str, float] = {}
    for parameter, value in values.items():
        plain = parameter.partition("@")[0]
        members = structured(independent.family_of(plain), setups)
        for name, weight in members.get(plain, {plain: 1.0}).items():
            stated[name] = stated.get(name, 0.0) + weight * value
    apart = [value - rig.error(name) for name, value in stated.items()]
    return bool(np.linalg.norm(apart) <= np.linalg.norm(list(stated.values())) / 2)


def seen(visible: Visible, size_of: Mapping[str, float], share: float) -> float:
    """Return what a cause shows past noise and the background of all others, sigmas.

    Args:
        visible: with that background as nuisances, this cause's own share among them.
        size_of: its parameters, in tolerances.
        share: the background, in tolerances.
    """
    length = float(np.linalg.norm(list(size_of.values())))
    shown = sum(v / length * visible.columns.get(n, 0.0) for n, v in size_of.items())
    square = float(np.sum(np.square(shown)))
    return float(length * np.sqrt(square / max(1 - share**2 * square, 1e-9)))


def oracle(visible: Visible, size: float, right: Callable[[str, Sequence[str]], bool]) -> bool:
    """Whether the cause would be in a set of at most twenty, by who is given everything but which:
    how large the background is, and that one cause of this size stands out of it, or none, at
    even odds.
    """
    residual, logs, hits = visible.residual(), [0.0], list[bool]()
    for name, candidate in visible.candidates.items():
        columns = size * candidate.columns
        inner = np.eye(columns.shape[1]) + columns.T @ columns
        along = columns.T @ residual
        logs.append(
            0.5 * float(along @ np.linalg.solve(inner, along))
            - 0.5 * float(np.linalg.slogdet(inner)[1])
            - float(np.log(len(visible.candidates)))
        )
        hits.append(right(name, candidate.parameters))
    weights = np.exp(np.array(logs) - max(logs))
    nothing, *each = weights / weights.sum()
    order = np.argsort(each)[::-1]
    count = int(np.searchsorted(np.cumsum(np.array(each)[order]), CREDIBLE * (1 - nothing))) + 1
    named = 1 - nothing >= NAMED and count <= MOST
    return bool(named and any(hits[k] for k in order[:count]))


def tables(found: Sequence[Record]) -> list[Table]:
    """The table."""
    lines = [["f, and the cause", "n", "it is clear", "named, alone or in a set", "oracle",
              "first and alone", "sets that hold it", "or say what is so", "as they state",
              "size of its set", "places said"]]  # fmt: skip
    told = [r for r in found if "sets" in r]
    for times in TIMES:
        for share in SHARES[1:]:
            rows = [r for r in told if (r["case"][0], r["case"][3]) == (share, times)]
            lines.append([f"{share:g}, {times} times that", *_row(rows)])
    for times in TIMES:
        for protocol in ac.PROTOCOLS:
            rows = [r for r in told if (r["case"][1], r["case"][3]) == (protocol, times)]
            lines.append([f"{protocol}, {times} times", *_row(rows)])
    return [Table("", "", [*lines, ["all", *_row(told)]])]


def _row(rows: Sequence[Record]) -> list[str]:
    clear = [r for r in rows if r["seen"] >= CLEAR]
    sets = [s for r in rows for s in r["sets"]]
    so = [(any(s), true) for r in rows for s, true in zip(r["sets"], r["so"], strict=True)]
    stated = [p for r in rows for p in r["stated"]]
    sizes = [len(s) for s in sets if any(s)]
    return [
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
    ]


def cases(machines: int) -> list[Case]:
    """Return so many machines of each share and each size of the cause; sheets alternate."""
    return [
        (share, ac.PROTOCOLS[k % len(ac.PROTOCOLS)], k, times)
        for k in range(machines)
        for share in SHARES[1:]
        for times in TIMES
    ]


if __name__ == "__main__":
    run_all(__doc__, cases, run, tables, machines=60)
