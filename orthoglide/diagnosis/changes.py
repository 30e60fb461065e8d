"""Changes between campaigns: a parameter with one value before a file and another from it on.

Campaigns are those of dials, in their order; without dials the files of the tool, where each reads
the same setups as the others.

The hypothesis "this parameter changed" is a column of its own in the readings: what the parameter
does to those of the later files. All that stays is open beside it. Sets of changes are weighed
(`fit.change_search`) on the same station means as faults of the data.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from orthoglide.diagnosis.station_means import StationMeans
from orthoglide.fit import Change, Problem, with_free
from orthoglide.fit.change_search import Found, Hypotheses, costs
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter

_OPEN = 3.0
"""Tolerances of the machine's other effects: what they are, they are at all visits."""


def visits(problem: Problem) -> tuple[tuple[str, str, int], ...]:
    """Campaigns between which something may have changed: name, file, and first row."""
    if problem.campaigns:
        read = [(c.name, c.file) for c in problem.campaigns]
    elif len({frozenset(f.setup_names) for f in problem.factors}) == 1:
        read = [(f.name, f.points.file) for f in problem.points]
    else:
        return ()
    return tuple(
        (name, file or name, rows.start)
        for (name, file), rows in zip(read, problem.factor_rows, strict=False)
    )


@dataclass(frozen=True)
class Changes:
    """What changed, all at once.

    Attributes:
        changes: without values, the most decisive first.
        columns: readings ``(n, k)`` by each, as wide as is likely of it.
        price: what their number and their priors take from their evidence.
    """

    changes: tuple[Change, ...]
    columns: Array
    price: float

    def evidence(self, means: StationMeans) -> float:
        """For all of them together, in the form of faults of the data."""
        left = means.allowing(means.shown(self.columns)).chi2
        return float(means.evidence(np.array(left))) - self.price


def likeliest_changes(means: StationMeans) -> Changes | None:
    """The changes that explain a residual best; ``None`` where nothing speaks for any.

    Args:
        means: of what a fit leaves, and all that may stand beside the changes.
    """
    problem, several = means.problem, visits(means.problem)
    if len(several) < 2:
        return None
    names, readings = _columns(means, several)
    columns = means.shown(readings)
    found = Hypotheses(
        columns.T @ columns,
        columns.T @ means.residual,
        costs(names, problem.machine.catalogue),
        means.chi2,
        means.dof,
        means.floor,
    ).found()
    if found is None:
        return None
    wide = readings[:, list(found.places)] * found.widths
    return Changes(tuple(_told(problem, several, names, found)), wide, found.price)


def _told(
    problem: Problem,
    several: Sequence[tuple[str, str, int]],
    names: Sequence[Parameter],
    found: Found,
) -> Iterator[Change]:
    stems, files = [stem for stem, _, _ in several], [file for _, file, _ in several]
    for place, evidence, size, rivals in zip(
        found.places, found.evidence, found.sizes, found.rivals, strict=True
    ):
        since = names[place].campaign
        sizes = {
            names[k].plain: v * problem.machine.tolerance(names[k].plain)
            for k, v in {place: float(size), **rivals}.items()
            if names[k].campaign == since
        }
        first = stems.index(since)
        yield Change(
            names[place].plain, tuple(sizes), since, (files[first - 1], files[first]),
            float(evidence), problem.machine.catalogue, sizes=tuple(sizes.values()),
        )  # fmt: skip


def everything_open(means: StationMeans) -> StationMeans:
    """Means with every effect of the catalogue in the model, as wide as is likely at all."""
    known, catalogue = means.signatures, means.problem.machine.catalogue
    columns: dict[str, Array] = {}
    for name, column in zip(known.names, (known.columns * known.tolerance).T, strict=True):
        parameter = catalogue.parameter(name)
        effect = catalogue.effect_of(parameter)
        # A plate keeps its shape, whichever campaign it was probed in.
        key = parameter.plain if effect.plate else name
        alone = effect.of_dial and not effect.plate
        columns[key] = columns.get(key, 0.0) + column * (1.0 if alone else _OPEN)
    wide = means.allowing(np.stack([*columns.values()], axis=1)) if columns else means
    return replace(wide, dof=means.dof)  # of noise and all that is open together


def _columns(
    means: StationMeans, several: Sequence[tuple[str, str, int]]
) -> tuple[list[Parameter], Array]:
    """What may have changed, and readings ``(n, c)`` by a tolerance of it: every parameter of the
    machine, and without dials of plates and patterns of equal legs too, from every campaign but the
    first on.
    """
    slopes = _slopes(means)
    names, columns = [], []
    for (plain, slope), (stem, _, start) in product(slopes.items(), several[1:]):
        if plain.setup or plain.at(stem) not in means.signatures.slopes:
            names.append(plain.at(stem))
            columns.append(np.where(np.arange(len(slope)) >= start, slope, 0.0))
    return names, np.stack(columns, axis=1) if columns else np.zeros(
        (len(means.problem.measured), 0)
    )


def _slopes(means: StationMeans) -> dict[Parameter, Array]:
    """Readings ``(n,)`` by what may have changed, at its tolerance, or what a repair takes."""
    problem, catalogue = means.problem, means.problem.machine.catalogue
    found: dict[Parameter, Array] = {}
    for name, slope in means.signatures.slopes.items():
        plain = catalogue.parameter(name).plain
        effect = catalogue.effect_of(plain)
        if not effect.of_dial or (effect.plate and not plain.member):
            one = slope * problem.machine.tolerance(plain)
            found[plain] = found[plain] + one if plain in found else one
    if not problem.campaigns:
        for name in dict.fromkeys(plain.effect for plain in found if not plain.setup):
            for member, weights in catalogue.structured(name).items():
                if set(weights) <= set(found):
                    parts = [w * found[part] for part, w in weights.items()]
                    found[member] = np.sum(parts, axis=0)
    return found


def separated(problem: Problem, changes: Sequence[Change]) -> Problem:
    """The problem with the changed parameters free and separate before and after the change."""
    changed = [change.parameter for change in changes]
    own = (*problem.own, *(name for change in changes for name in change.own))
    kept = tuple(u for u in problem.unknowns if u.name.plain not in changed)
    return with_free(replace(problem, unknowns=kept, own=own), changed)
