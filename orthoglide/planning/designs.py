"""A design before any measurement: the readings to take, and how they compare with protocols."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from orthoglide.effects import BASE_FAMILIES, MACHINE_PARAMETERS, family_of, is_dial
from orthoglide.errors import InputError
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign
from orthoglide.planning.bench import Bench
from orthoglide.planning.choosing import choose
from orthoglide.planning.detectable import Detectability, Smallest
from orthoglide.planning.expected import bench_of, expected_noise, machine_families
from orthoglide.planning.objectives import Determinant, Discriminate, gram, separations
from orthoglide.planning.observability import Observability, observability
from orthoglide.planning.pool import reading_pool, sheet
from orthoglide.planning.precision import Repeats
from orthoglide.units import Unit

Criterion = Literal["d-optimal", "discriminate"]

_NEVER = 5.0  # sigmas by the whole pool: a pair that no few of its readings tell apart
_LOOSE = 100.0  # tolerances: priors that keep a determinant finite and otherwise say nothing


@dataclass(frozen=True)
class Pair:
    """Two effects at their tolerance; ``other`` is empty where one stands against none.

    Attributes:
        one: parameter.
        other: parameter.
        sigmas: between them, base, datums and the other's size fitted.
    """

    one: str
    other: str
    sigmas: float


@dataclass(frozen=True)
class Design:
    """Readings chosen before any is taken.

    Attributes:
        criterion: ``d-optimal`` or ``discriminate``.
        names: parameters it is for, the base last where it is fitted besides.
        campaign: a measuring sheet.
        value: of the criterion: log det of the information in tolerances, gained over its loose
            priors; or the sigmas between the two effects that are hardest to tell apart.
        indices: of the sheet for ``names``.
        closest: for ``discriminate``: pairs that are told apart least, least first.
        never: for ``discriminate``: pairs that no few readings within reach tell apart.
    """

    criterion: Criterion
    names: tuple[str, ...]
    campaign: Campaign
    value: float
    indices: Observability
    closest: tuple[Pair, ...] = ()
    never: tuple[Pair, ...] = ()


def design(
    machine: Machine,
    families: Sequence[str] = BASE_FAMILIES,
    count: int = 24,
    criterion: Criterion = "d-optimal",
    *,
    noise: float | None = None,
    pool: Campaign | None = None,
) -> Design:
    """Choose readings before any is taken: greedily, then by exchange of whole mountings.

    Args:
        machine: tolerances, dial, and where to linearise.
        families: families, parameters or structured members: to identify (``d-optimal``), or to
            tell apart (``discriminate``; offsets and lengths are fitted besides).
        count: readings.
        criterion: ``d-optimal``: the largest determinant of the information, with priors of a
            hundred tolerances; ``discriminate``: the largest least separation of two effects at
            tolerance.
        noise: standard deviation of one reading, metres.
        pool: to choose from; all of ``reading_pool`` where absent.

    Raises:
        InputError: for dial effects, too few readings, or an unknown criterion.
    """
    if criterion not in get_args(Criterion):
        raise InputError(
            f"there is no criterion {criterion!r}: it is one of {', '.join(get_args(Criterion))}"
        )
    pool = pool or reading_pool(machine.geometry)
    names = machine_families(machine, pool, families)
    if criterion == "d-optimal":
        bench = bench_of(machine, pool, names, noise)
        rows, best = choose(
            bench, Determinant(_LOOSE**2 * np.eye(len(names))), count, exchange=True
        )
        return _finished(machine, bench, names, rows, criterion, best.value, noise)
    base = machine_families(machine, pool, BASE_FAMILIES)
    effects = tuple(n for n in names if n not in base)
    if not effects:
        raise InputError("offsets and lengths are always fitted: name other effects to tell apart")
    return _discriminating(machine, pool, (*base, *effects), len(base), count, noise)


def _finished(
    machine: Machine,
    bench: Bench,
    names: tuple[str, ...],
    rows: Sequence[int],
    criterion: Criterion,
    value: float,
    noise: float | None,
    closest: tuple[Pair, ...] = (),
    never: tuple[Pair, ...] = (),
) -> Design:
    campaign = sheet(bench.pool, rows, "design")
    level = expected_noise(machine, campaign, noise)
    seen = observability(machine, campaign, names, level)
    return Design(criterion, names, campaign, value, seen, closest, never)


def _discriminating(
    machine: Machine,
    pool: Campaign,
    names: tuple[str, ...],
    base: int,
    count: int,
    noise: float | None,
) -> Design:
    bench = bench_of(machine, pool, names, noise)
    size = len(names) - base
    pairs = np.array([(i, j) for i in range(size) for j in range(i, size)])
    prior = np.diag([1.0] * base + [0.0] * size)
    everything = np.sqrt(separations(gram(prior + bench.everything, base), pairs))
    possible = everything >= _NEVER
    if not possible.any():
        raise InputError("no reading within reach shows any of these effects at its tolerance")
    rows, best = choose(bench, Discriminate(prior, base, pairs[possible]), count, exchange=True)
    sigmas = np.sqrt(best.squares)
    order = np.argsort(sigmas, kind="stable")
    closest = tuple(_pair(names[base:], pairs[possible][k], sigmas[k]) for k in order)
    never = tuple(_pair(names[base:], pairs[k], everything[k]) for k in np.flatnonzero(~possible))
    return _finished(
        machine, bench, names, rows, "discriminate", float(sigmas.min()), noise, closest, never
    )


def _pair(names: Sequence[str], places: Array, sigmas: float) -> Pair:
    i, j = (int(k) for k in places)
    return Pair(names[i], "" if i == j else names[j], float(sigmas))


# -- in words ------------------------------------------------------------------------------------


def report_design(
    found: Design | None = None,
    compared: Sequence[tuple[str, Observability]] = (),
    detectability: Detectability | None = None,
    repeats: Sequence[Repeats] = (),
) -> tuple[str, ...]:
    """Rows of text for the command line.

    Args:
        found: a design.
        compared: names of campaigns or protocols with their indices.
        detectability: of a protocol.
        repeats: answers to "how often".
    """
    lines: list[str] = []
    if compared or found:
        lines += _index_rows([*compared, *([(found.criterion, found.indices)] if found else [])])
    if found is not None:
        lines += _pair_rows(found)
    for answer in repeats:
        lines.append(_repeats_row(answer))
    if detectability is not None:
        lines += _detectable_rows(detectability)
    return tuple(lines)


def _index_rows(compared: Sequence[tuple[str, Observability]]) -> list[str]:
    head = f"{'':<16}{'readings':>9}{'seen':>9}" + "".join(f"{f'O{k}':>10}" for k in range(1, 6))
    return [
        head,
        *(
            f"{name:<16}{o.readings:>9}{f'{o.rank}/{o.unknowns}':>9}"
            + "".join(f"{v:>10.3g}" for v in o.indices.values())
            for name, o in compared
        ),
    ]


def _pair_rows(found: Design) -> list[str]:
    lines = []
    for pair in found.closest[:5]:
        against = f"from {pair.other}" if pair.other else "from no effect at all"
        lines.append(f"{pair.one} {against}: {pair.sigmas:.1f} sigma at tolerance")
    for pair in found.never:
        against = f"{pair.one} and {pair.other}" if pair.other else pair.one
        lines.append(f"{against}: no few readings within reach tell at tolerance")
    return lines


def _repeats_row(answer: Repeats) -> str:
    unit = Unit("mm", 1e-3) if answer.what == "TCP" else family_of(answer.what).unit
    wanted, sigma, floor = (v / unit.si for v in (answer.wanted, answer.sigma, answer.floor))
    if answer.repeats is None:
        return (
            f"{answer.what}: sigma {wanted:.3g} {unit.name} is out of reach of repeats: "
            f"{sigma:.3g} with one visit, {floor:.3g} with any number"
        )
    return (
        f"{answer.what}: sigma {wanted:.3g} {unit.name} takes {answer.repeats} "
        f"{'visit' if answer.repeats == 1 else 'visits'} to every station (then {sigma:.3g})"
    )


def _detectable_rows(found: Detectability) -> list[str]:
    """A row a family: the member that takes the largest effect to be found, and to be named."""
    by_family: dict[str, list[Smallest]] = {}
    for smallest in found.smallest:
        if is_elementary(smallest.name):
            by_family.setdefault(family_of(smallest.name).name, []).append(smallest)
    lines = [f"{'effect':<20}{'tolerance':>11}{'found from':>12}{'named from':>12}  unit  nearest"]
    lines += [_family_row(name, members) for name, members in by_family.items()]
    if found.invisible:
        lines.append(f"not visible, which is not absent: {', '.join(found.invisible)}")
    return lines


def _family_row(name: str, members: Sequence[Smallest]) -> str:
    family = family_of(name)
    si, hardest = family.unit.si, max(members, key=lambda s: s.nameable)
    named = f"{hardest.nameable / si:.2g}" if np.isfinite(hardest.nameable) else "never"
    found = max(s.detectable for s in members) / si
    return (
        f"{name:<20}{hardest.tolerance / si:>11.2g}{found:>12.2g}{named:>12}  "
        f"{family.unit.name:<4}  {hardest.nearest} for {hardest.name}"
    )


def is_elementary(name: str) -> bool:
    """Whether a candidate is a single parameter, no structured member of a family."""
    return name in MACHINE_PARAMETERS or (is_dial(name) and not name.endswith(".common"))
