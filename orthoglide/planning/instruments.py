"""Which other instrument would tell rivals apart, where no dial can be set against the legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.effects.wording import cause_short
from orthoglide.fit import Estimate
from orthoglide.fit.tool_noise import REPEATABILITY
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.numerals import compact
from orthoglide.posterior import Cause, Explanation
from orthoglide.prediction import Conditions

_DIRECTIONS = 12
_TELLS = 4.0  # sigmas
_SHEET = "orthoglide design --owns {0} --machine machine.toml --out {0}.csv"
_TURN = np.pi / 3  # of a plate on its seat: the lobes of a shape of three come to its hollows


@dataclass(frozen=True)
class InstrumentReadings:
    """What instruments would read of one explanation over the plate.

    Attributes:
        words: the cause, without its size.
        distances: between neighbours and opposites on a circle ``(m,)``, metres.
        turns: of the platform ``(n, 2)`` about x and y, radians.
        turned: heights with the plate turned, less those as it is ``(n,)``, metres.
    """

    words: str
    distances: Array
    turns: Array
    turned: Array


def deciding(
    fit: Estimate, causes: Sequence[Cause], machine: Machine
) -> tuple[tuple[str, float], ...]:
    """What would tell rivals apart, in sentences with the sigmas between the two that differ most.

    Each rival's machine predicts what an instrument would read on a circle on the plate; what the
    instrument's own nuisances take up is taken out.

    Args:
        fit: of the readings at hand.
        causes: that were found, with their rivals.
        machine: that knows them, and the places found.
    """
    pairs, found = list[tuple[InstrumentReadings, InstrumentReadings]](), []
    for cause in causes:
        chosen = _readings_of(cause.chosen, fit, machine)
        pairs += [
            (chosen, _readings_of(other, fit, machine)) for other in (*cause.same, *cause.rivals)
        ]
    for kind, what, unit, of in (
        ("distance", "distances between holes or pillars around the rim and across it, each with "
         "its own width and the part's shrinkage", "mm", _distances),
        ("incline", "a level on the platform, read about x and y around the rim", "mrad", _turns),
        ("plate", "a mesh with the plate turned by 60 degrees on its seat, as a setup of its own "
         "with 60 under turned_deg (of a printer: a profile of its own, imported with "
         "--turned NAME=60)",
         "mm", _turned),
    ):  # fmt: skip
        best = max(pairs, key=lambda pair: _apart(of(*pair)), default=None)
        if best is None:
            continue
        apart, sigma = _apart(of(*best)), REPEATABILITY[kind]
        if apart < _TELLS * sigma:
            continue
        one, other = (s.words for s in best)
        found.append(
            (
                f"{what}: it differs by up to {compact(apart * 1e3, 2)} {unit} between two of them "
                f"({one}; {other}), and one reading repeats to {compact(sigma * 1e3, 2)} {unit} "
                f"(a sheet for it: {_SHEET.format(kind)})",
                apart / sigma,
            )
        )
    return tuple(sorted(found, key=lambda item: -item[1]))


def _apart(difference: Array) -> float:
    return float(np.abs(difference).max(initial=0.0))


def _distances(one: InstrumentReadings, other: InstrumentReadings) -> Array:
    """Scale and offset taken out."""
    apart = one.distances - other.distances
    columns = np.stack([one.distances, np.ones(len(apart))], axis=1)
    return np.asarray(apart - columns @ np.linalg.lstsq(columns, apart, rcond=None)[0])


def _turns(one: InstrumentReadings, other: InstrumentReadings) -> Array:
    """Datums taken out."""
    apart = one.turns - other.turns
    return np.asarray(apart - apart.mean(axis=0))


def _turned(one: InstrumentReadings, other: InstrumentReadings) -> Array:
    return one.turned - other.turned


def _readings_of(one: Explanation, fit: Estimate, machine: Machine) -> InstrumentReadings:
    problem, catalogue = fit.problem, one.catalogue
    points = np.concatenate([p.conditions().command for p in problem.points])
    radius = 0.9 * float(np.hypot(*machine.forward(points)[:, :2].T).max())
    angle = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    ring = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    at = Conditions.at(machine.with_only({}).inverse(ring))
    out = machine.model.outputs({n: v for n, v in one.machine.items() if v}, at)
    half, near = _DIRECTIONS // 2, _DIRECTIONS // 6
    spans = [np.roll(out.p, -k, axis=0) - out.p for k in (near, 2 * near, half)]
    turn = 0.5 * np.stack(
        [out.R[:, 2, 1] - out.R[:, 1, 2], out.R[:, 0, 2] - out.R[:, 2, 0]], axis=1
    )
    turned = np.zeros(_DIRECTIONS)
    for name, value in one.values.items():
        effect = catalogue.effect_of(name)
        if effect.plate:
            setups = [s for f in problem.factors for s in f.setup_names]
            shape = effect.shape(catalogue.parameter(name, setups))
            there, here = angle - _TURN, angle
            turned += value * (
                shape(np.cos(there), np.sin(there)) - shape(np.cos(here), np.sin(here))
            )
    distances = np.concatenate([np.linalg.norm(s, axis=1) for s in spans])
    return InstrumentReadings(cause_short(catalogue, one.name), distances, turn, turned)
