"""Rivals that no few readings tell apart: which belong together, and whether it matters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from orthoglide.accuracy import workspace
from orthoglide.effects import is_dial
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.planning.bench import Bench
from orthoglide.planning.explanations import Explanation
from orthoglide.prediction import Conditions

_SAME = 0.02  # of the shift between two machines: less is no difference in shape
_GRID = 3


def groups(apart: Mapping[tuple[int, int], float]) -> list[tuple[list[int], float]]:
    """Rivals of which no two can be told apart, and the most sigmas between any two.

    Args:
        apart: sigmas of the pairs that cannot be, either way round or both.
    """
    known = {(min(p), max(p)): s for p, s in apart.items()}

    def joined(members: set[int]) -> list[float] | None:
        found = [known.get((a, b)) for a in members for b in members if a < b]
        return None if None in found else [s for s in found if s is not None]

    sets: list[set[int]] = []
    for pair in sorted(known):
        if any(set(pair) <= group for group in sets):
            continue
        for group in sets:
            if joined(group | set(pair)) is not None:
                group |= set(pair)
                break
        else:
            sets.append(set(pair))
    return [(sorted(group), max(joined(group) or [0.0])) for group in sets]


def in_words(machine: Machine, bench: Bench, alike: Sequence[Explanation], sigmas: float) -> str:
    """Why no reading is proposed for rivals, and what it means for the TCP.

    Args:
        machine: of the workspace.
        bench: the pool they were judged by.
        alike: the rivals.
        sigmas: the most that was found between two of them.
    """
    names = [e.name for e in alike]
    points = [_tcp(machine, e) for e in alike]
    apart = [_apart(p, q) for p in points for q in points]
    shift, rest = (max(column) for column in zip(*apart, strict=True))
    level = bench.scatter.reading
    if max(shift, rest) < level:
        tail = "their TCPs are the same, too"
    elif rest < max(_SAME * shift, level):
        tail = f"their TCPs are the same but for a shift of {shift * 1e3:.2g} mm"
    else:
        tail = (
            f"their TCPs differ by up to {rest * 1e3:.2g} mm after the best shift: measure the "
            "TCP, or look at the parts themselves"
        )
    return (
        f"no few readings of a dial on a leg tell {', '.join(names[:-1])} and {names[-1]} apart "
        f"(out of {len(bench.pool)} within reach; {sigmas:.1f} sigma at most); {tail}"
    )


def _tcp(machine: Machine, one: Explanation) -> Array:
    conditions = Conditions.at(workspace(machine.geometry, _GRID))
    values = {n: v for n, v in one.values.items() if not is_dial(n)}
    return machine.model.outputs(values, conditions).p


def _apart(p: Array, q: Array) -> tuple[float, float]:
    """Between two sets of points: length of the best shift, and the most it leaves, metres."""
    shift = (p - q).mean(axis=0)
    return float(np.linalg.norm(shift)), float(np.linalg.norm(p - q - shift, axis=1).max())
