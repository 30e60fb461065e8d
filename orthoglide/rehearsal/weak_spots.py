"""What a sheet hardly sees or cannot tell apart, before anything is measured."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.accuracy import tcp_slopes, without_place
from orthoglide.effects import Catalogue, Effect
from orthoglide.effects.wording import cause_short, size_words
from orthoglide.ordering import best_of
from orthoglide.parameters import Parameter
from orthoglide.prospects import SmallestEffect, smallest_effects
from orthoglide.rehearsal.drawing import Scope
from orthoglide.simulation import lacks

HARDLY = 3.0
"""Tolerances: an effect that must be larger to be seen is hardly seen."""

_SAME_TOOL = 0.99
"""Cosine between what two effects do to the tool from which they are one cause with two names."""


@dataclass(frozen=True)
class WeakSpot:
    """Something that a sheet does not show, or not well."""

    names: tuple[str, ...]  # of the parameters or effects
    words: str  # what that means at the machine, a sentence

    def __str__(self) -> str:
        return self.words


def weak_spots(scope: Scope, seed: int = 0) -> tuple[WeakSpot, ...]:
    """A sheet's weak spots: what it does not record, see, see well, or tell apart.

    Sizes are those found, or told from every other single effect, with 95 % probability on a
    machine on which nothing else is wrong.
    """
    seen = smallest_effects(scope.machine, scope.sheets, seed=seed)
    single = [s for s in seen.smallest if s.elementary]
    catalogue, of = scope.machine.catalogue, scope.machine.catalogue.effect_of
    return (
        *_not_recorded(scope, {of(n).name for n in (*seen.invisible, *(s.name for s in single))}),
        *_invisible(catalogue, seen.invisible),
        *_hardly(catalogue, single),
        *_confused(scope, single),
    )


def _not_recorded(scope: Scope, judged: Collection[str]) -> Iterator[WeakSpot]:
    catalogue = scope.machine.catalogue
    dials = any(not sheet.of_tool for sheet in scope.sheets)
    for effect in catalogue.values():
        if effect.name in (*catalogue.base, *judged) or effect.instead_of or effect.of_body:
            continue
        if effect.of_dial and not dials:
            continue
        lacking = lacks(effect.needs)
        yield WeakSpot((effect.name,), f"not shown, as {lacking}: {_many(effect)}")


def _invisible(catalogue: Catalogue, names: Sequence[Parameter]) -> Iterator[WeakSpot]:
    for _, members in _by_effect(catalogue, names):
        yield WeakSpot(tuple(members), f"not seen, whatever the size: {_told(catalogue, members)}")


def _hardly(catalogue: Catalogue, single: Sequence[SmallestEffect]) -> Iterator[WeakSpot]:
    weak = {s.name: s for s in single if s.detectable > HARDLY * s.tolerance}
    for effect, members in _by_effect(catalogue, weak):
        worst = best_of((weak[n] for n in members), lambda s: s.detectable)
        yield WeakSpot(
            tuple(members),
            f"seen from {size_words(effect, worst.detectable)}, "
            f"{worst.detectable / worst.tolerance:.1f} times the tolerance: "
            f"{_told(catalogue, members)}",
        )


def _confused(scope: Scope, single: Sequence[SmallestEffect]) -> Iterator[WeakSpot]:
    catalogue, told = scope.machine.catalogue, set[frozenset[str]]()
    for s in single:
        pair = frozenset((s.name, s.nearest))
        seen = s.detectable <= HARDLY * s.tolerance
        if not seen or s.nameable <= HARDLY * s.tolerance or not s.nearest or pair in told:
            continue
        told.add(pair)
        if _same_tool(scope, s.name, s.nearest):
            continue
        size = "whatever the size"
        if np.isfinite(s.nameable):
            size = f"below {size_words(catalogue[s.effect], s.nameable)}"
        one, other = (cause_short(catalogue, n) for n in (s.name, s.nearest))
        yield WeakSpot((s.name, s.nearest), f"not told apart {size}: {one}, or {other}")


def _same_tool(scope: Scope, one: str, other: str) -> bool:
    """Whether two causes move the tool alike, so that it does not matter which it is."""
    catalogue = scope.machine.catalogue
    if catalogue.effect_of(one).of_dial or catalogue.effect_of(other).of_dial:
        return False
    parts = [catalogue.elementary(n) for n in (one, other)]
    names = list(dict.fromkeys(str(n) for part in parts for n in part))
    slopes = without_place(tcp_slopes(scope.machine, names)).reshape(-1, len(names))
    a, b = (slopes @ [part.get(n, 0.0) for n in names] for part in parts)
    return bool(abs(a @ b) >= _SAME_TOOL * np.linalg.norm(a) * np.linalg.norm(b))


def _by_effect(
    catalogue: Catalogue, names: Iterable[Parameter]
) -> Iterator[tuple[Effect, list[Parameter]]]:
    found: dict[str, list[Parameter]] = {}
    for name in names:
        found.setdefault(name.effect, []).append(name)
    return ((catalogue[effect], members) for effect, members in found.items())


def _told(catalogue: Catalogue, names: Sequence[Parameter]) -> str:
    """Parameters of one effect as a clause: one in words, several by the effect and their tails."""
    if len(names) == 1:
        return cause_short(catalogue, names[0])
    effect = catalogue.effect_of(names[0])
    tails = ", ".join(n.plain.behind for n in names)
    return f"{_many(effect)} ({tails})"


def _many(effect: Effect) -> str:
    return effect.words.many or effect.sentence
