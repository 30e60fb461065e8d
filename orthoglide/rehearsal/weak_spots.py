"""What a sheet hardly sees or cannot name, before anything is measured."""

from __future__ import annotations

from orthoglide.planning import detectable_rows, smallest_effects
from orthoglide.rehearsal.drawing import Scope
from orthoglide.simulation import lacks

HARDLY = 3.0
"""Tolerances: an effect that must be larger to be found, or named, is a weak spot of the sheet."""

_WIDTH = 100  # characters of a line


def weak_spots(scope: Scope, seed: int = 0) -> tuple[str, ...]:
    """Return rows of text: effects that are found or named from more than three tolerances only,
    and those that the sheet cannot show, each with the reason.

    Sizes are those found, or named, with 95 % probability on a machine on which nothing else is
    wrong.
    """
    machine, catalogue = scope.machine, scope.machine.catalogue
    seen = smallest_effects(machine, scope.sheets, seed=seed)
    names = (*seen.invisible, *(s.name for s in seen.smallest if s.elementary))
    judged = {*catalogue.base, *(catalogue.effect_of(name).name for name in names)}
    dials = any(sheet.on_legs.any() for sheet in scope.sheets)
    missing: dict[str, list[str]] = {}
    for effect in catalogue.values():
        of_others = effect.instead_of or effect.of_body or (effect.of_dial and not dials)
        if effect.name not in judged and not of_others:
            missing.setdefault(lacks(effect.needs), []).append(effect.name)
    return (
        *detectable_rows(seen, _WIDTH, HARDLY),
        *(f"not shown, as {reason}: {', '.join(effects)}" for reason, effects in missing.items()),
    )
