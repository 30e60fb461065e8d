"""Which other instrument would tell rivals apart, where no dial can be set against the legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from orthoglide.effects.wording import cause_short
from orthoglide.fit import Estimate
from orthoglide.fit.tool import REPEATABILITY
from orthoglide.geometry import Array
from orthoglide.numerals import compact
from orthoglide.prediction import Conditions

_DIRECTIONS = 12
_TELLS = 4.0  # sigmas
_TURN = np.pi / 3  # of a plate on its seat: the lobes of a shape of three come to its hollows


@dataclass(frozen=True)
class Shown:
    """What instruments would read of one explanation over the plate.

    Attributes:
        name: of the cause.
        distances: between neighbours and opposites on a circle ``(m,)``, metres.
        turns: of the platform ``(n, 2)`` about x and y, radians.
        turned: heights with the plate turned, less those as it is ``(n,)``, metres.
    """

    name: str
    distances: Array
    turns: Array
    turned: Array


def deciding(rivals: Sequence[tuple[str, Estimate]]) -> tuple[tuple[str, float], ...]:
    """What would tell rivals apart, in sentences with the sigmas between the two that differ most.

    The rivals' own fits predict what an instrument would read on a circle on the plate; what its
    own nuisances take up is taken out.

    Args:
        rivals: names with their fits, the chosen one first.
    """
    shown = [_shown(name, fit) for name, fit in rivals]
    found = []
    for what, unit, sigma, of in (
        ("distances between holes or pillars around the rim and across it, each with its own width "
         "and the part's shrinkage", "mm", REPEATABILITY["distance"], _distances),
        ("a level on the platform, read about x and y around the rim", "mrad",
         REPEATABILITY["incline"], _turns),
        ("a mesh with the plate turned by 60 degrees on its seat, as a setup of its own", "mm",
         REPEATABILITY["plate"], _turned),
    ):  # fmt: skip
        best = max(combinations(shown, 2), key=lambda pair: _apart(of(*pair)), default=None)
        if best is None:
            continue
        apart = _apart(of(*best))
        if apart < _TELLS * sigma:
            continue
        catalogue = rivals[0][1].problem.machine.catalogue
        one, other = (cause_short(catalogue, s.name) for s in best)
        found.append(
            (
                f"{what}: {one!r} and {other!r} would differ by up to {compact(apart * 1e3, 2)} "
                f"{unit}, where one reading repeats to {compact(sigma * 1e3, 2)} {unit}",
                apart / sigma,
            )
        )
    return tuple(sorted(found, key=lambda item: -item[1]))


def _apart(difference: Array) -> float:
    return float(np.abs(difference).max(initial=0.0))


def _distances(one: Shown, other: Shown) -> Array:
    """Scale and offset taken out."""
    apart = one.distances - other.distances
    columns = np.stack([one.distances, np.ones(len(apart))], axis=1)
    return np.asarray(apart - columns @ np.linalg.lstsq(columns, apart, rcond=None)[0])


def _turns(one: Shown, other: Shown) -> Array:
    """Datums taken out."""
    apart = one.turns - other.turns
    return np.asarray(apart - apart.mean(axis=0))


def _turned(one: Shown, other: Shown) -> Array:
    return one.turned - other.turned


def _shown(name: str, fit: Estimate) -> Shown:
    problem = fit.problem
    machine, values = problem.machine, problem.values(problem.last, fit.x)
    catalogue = machine.catalogue
    points = np.concatenate([p.conditions().command for p in problem.points])
    radius = 0.9 * float(np.hypot(*machine.forward(points)[:, :2].T).max())
    angle = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    ring = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    at = Conditions.at(machine.with_only({}).inverse(ring))
    own = {n: v for n, v in values.items() if not catalogue.effect_of(n).of_dial}
    out = machine.model.outputs(own, at)
    half, near = _DIRECTIONS // 2, _DIRECTIONS // 6
    spans = [np.roll(out.p, -k, axis=0) - out.p for k in (near, 2 * near, half)]
    turn = 0.5 * np.stack(
        [out.R[:, 2, 1] - out.R[:, 1, 2], out.R[:, 0, 2] - out.R[:, 2, 0]], axis=1
    )
    turned = np.zeros(_DIRECTIONS)
    for parameter, value in values.items():
        shapes = catalogue.effect_of(parameter).shapes
        if shapes:
            shape = shapes[catalogue.parameter(parameter).direction]
            there, here = angle - _TURN, angle
            turned += value * (
                shape(np.cos(there), np.sin(there)) - shape(np.cos(here), np.sin(here))
            )
    distances = np.concatenate([np.linalg.norm(s, axis=1) for s in spans])
    return Shown(name, distances, turn, turned)
