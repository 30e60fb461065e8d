"""A design before any measurement: the readings to take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from orthoglide.errors import InputError, check_list, check_word
from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings
from orthoglide.ordering import EQUAL_ODDS, descending
from orthoglide.planning.choosing import choose
from orthoglide.planning.criteria import Determinant, EffectSeparation
from orthoglide.planning.linear import LinearReadings
from orthoglide.planning.observability import Observability, observability
from orthoglide.planning.pool import reading_pool, sheet
from orthoglide.threads import on_one_thread

if TYPE_CHECKING:
    import pandas as pd

Criterion = Literal["d-optimal", "discriminate"]

_NEVER = 5.0  # sigmas by the whole pool: a pair that no few of its readings tell apart
_LOOSE = 100.0  # tolerances: priors that keep a determinant finite and otherwise say nothing


@dataclass(frozen=True)
class Pair:
    """Two effects at their tolerance; ``other`` is empty where one stands against none."""

    one: str  # parameter
    other: str  # parameter
    sigmas: float  # between them, zeros and lengths, datums and the other's size fitted


@dataclass(frozen=True)
class Design:
    """Readings chosen before any is taken.

    Attributes:
        criterion: ``d-optimal`` or ``discriminate``.
        names: parameters it is for; those fitted besides come first.
        campaign: a measuring sheet.
        value: of the criterion: log det of the information in tolerances, gained over its loose
            priors; or the sigmas between the two effects that are hardest to tell apart.
        indices: of the sheet for ``names``.
        closest: for ``discriminate``: pairs that are told apart least, least first.
        never: for ``discriminate``: pairs that no few readings within reach tell apart.
    """

    criterion: Criterion
    names: tuple[str, ...]
    campaign: Readings
    value: float
    indices: Observability
    closest: tuple[Pair, ...] = ()
    never: tuple[Pair, ...] = ()

    def __repr__(self) -> str:
        count, names = len(self.campaign), len(self.names)
        return f"<Design, {self.criterion}: {count} readings for {names} parameters>"

    def to_frame(self) -> pd.DataFrame:
        """The measuring sheet as a data frame, a row a reading.

        Raises:
            InputError: where pandas is not installed.
        """
        return self.campaign.to_frame()

    def _repr_html_(self) -> str:
        return self.campaign._repr_html_()


@on_one_thread
def design(
    machine: MachineSource,
    free: Sequence[str] | None = None,
    count: int = 24,
    criterion: Criterion = "d-optimal",
    *,
    noise: float | None = None,
    pool: Readings | None = None,
) -> Design:
    """Choose readings before any is taken: greedily, then by exchange of whole mountings.

    Args:
        machine: tolerances, dial, and where to linearise.
        free: effects, parameters or structured members: to identify (``d-optimal``; zeros and
            lengths if None), or to tell apart (``discriminate``; all that a design can show if
            None, zeros and lengths being fitted besides).
        count: readings.
        criterion: ``d-optimal``: the largest determinant of the information, with priors of a
            hundred tolerances; ``discriminate``: the largest least separation of two effects at
            tolerance.
        noise: standard deviation of one reading, metres.
        pool: to choose from; all of ``reading_pool`` where absent.

    Raises:
        InputError: for dial effects, too few readings, or an unknown criterion.
    """
    check_word("criterion", criterion, get_args(Criterion))
    check_list("free", free)
    machine = Machine.of(machine)
    pool = pool or reading_pool(machine.geometry)
    closest: tuple[Pair, ...] = ()
    never: tuple[Pair, ...] = ()
    base = machine.catalogue.base
    if criterion == "d-optimal":
        names = shown_names(machine, pool, base if free is None else free)
        readings = LinearReadings.of(machine, pool, names, noise)
        start = Determinant(np.eye(len(names)) / _LOOSE**2)
        rows, best = choose(readings, start, count, exchange=True)
        if not rows:
            raise InputError("through this noise no reading says anything: correct it")
        value = best.value - start.value
    else:
        fitted = machine.catalogue.expand(base)
        apart = tuple(n for n in shown_names(machine, pool, free or ()) if n not in fitted)
        if not apart:
            raise InputError(
                "offsets and lengths are always fitted: name other effects to tell apart"
            )
        names = (*fitted, *apart)
        readings = LinearReadings.of(machine, pool, names, noise)
        rows, closest, never = _told_apart(readings, apart, len(fitted), count)
        value = closest[0].sigmas
    campaign = sheet(pool, rows, "design")
    seen = observability(machine, campaign, names, noise)
    return Design(criterion, names, campaign, value, seen, closest, never)


def shown_names(machine: Machine, pool: Readings, free: Sequence[str]) -> tuple[str, ...]:
    """Parameters of the machine that names stand for; all that a design can show where empty.

    Raises:
        InputError: for effects of the dial, which belong to a mounting and not to a design, and for
            those that no reading of the pool can show.
    """
    catalogue = machine.catalogue
    given = {"approach"}
    given |= {"load"} if pool.load.any() else set()
    given |= set() if machine.spec.screw_pitch is None else {"pitch"}
    if not free:
        free = [n for n, e in catalogue.items() if not e.of_dial and e.needs <= given]
    for name in free:
        effect = catalogue.effect_of(name)
        if effect.of_dial:
            raise InputError(
                f"{name} belongs to one mounting of a dial: a design is for parameters of the "
                "machine, leave it out"
            )
        if not effect.needs <= given:
            raise InputError(
                f"{name} shows in no reading that a design can choose (no load, warmth, drift or "
                "screw pitch is known): leave it out"
            )
    return catalogue.expand(free)


def _told_apart(
    readings: LinearReadings, names: Sequence[str], base: int, count: int
) -> tuple[tuple[int, ...], tuple[Pair, ...], tuple[Pair, ...]]:
    """Rows that tell effects apart, pairs by their separation, and pairs that nothing separates;
    the readings are by the base, which is fitted besides, then by the effects.
    """
    size = len(names)
    pairs = np.array([(i, j) for i in range(size) for j in range(i, size)])
    prior = np.diag([1.0] * base + [0.0] * size)
    most = np.sqrt(EffectSeparation(prior + readings.information(), base, pairs).squares)
    possible = most >= _NEVER
    if not possible.any():
        raise InputError("no reading within reach shows any of these effects at its tolerance")
    start = EffectSeparation(prior, base, pairs[possible])
    rows, best = choose(readings, start, count, exchange=True)
    sigmas = np.sqrt(best.squares)

    def described(places: Array, values: Array) -> tuple[Pair, ...]:
        return tuple(
            Pair(names[i], "" if i == j else names[j], float(s))
            for (i, j), s in zip(places.tolist(), values, strict=True)
        )

    order = descending(-np.log(np.maximum(sigmas, 1e-6)), EQUAL_ODDS)
    closest = described(pairs[possible][order], sigmas[order])
    return rows, closest, described(pairs[~possible], most[~possible])
