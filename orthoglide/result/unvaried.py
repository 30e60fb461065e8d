"""What a result's readings cannot show as nothing in them varies it: lost motion above all."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Literal

from orthoglide.effects.wording import cause_short
from orthoglide.fit.excited import unmet
from orthoglide.posterior.free import one_surface

if TYPE_CHECKING:
    from orthoglide.result.result import Result


_OF_ONE = "one alone, or several differently"


def unshown(result: Result) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Effects that the readings would not show at three tolerances: in words, and which of an
    effect's parameters where it is not all of them; of one that is told, all alike, only others.
    """
    asked = [] if result.posterior is None else result.posterior.about.asked
    every, hidden = (Counter(n.effect for n in names) for names in (asked, result.invisible))
    several = [one for cause in result.effects for one in cause.explanations]
    told = {one.catalogue.effect_of(one.name).name for one in several}

    def which(effect: str) -> tuple[str, ...]:
        if hidden[effect] == every[effect]:
            return (_OF_ONE,) if effect in told else ()
        names = (str(n) for n in result.invisible if n.effect == effect)
        return tuple(name.removeprefix(f"{effect}.") for name in names)

    return tuple((cause_short(result.catalogue, effect), which(effect)) for effect in hidden)


def unvaried(result: Result) -> dict[str, tuple[str, ...]]:
    """Effects of the machine that nothing in the readings varies, each with what would:
    ``approach``, ``load`` ...; empty where no cause was looked for.
    """
    problem = result.after.problem
    several = () if result.posterior is None else problem.machine.catalogue.effects
    asked = (e for e in several if not (e.of_dial or e.instead_of) and e.name in result.unexcited)
    return {effect.name: unmet(problem, effect) for effect in asked}


def one_sided(result: Result) -> Literal["", "fixed", "same", "unknown"]:
    """Why lost motion is not seen: all that was read has but one side, the side that places were
    come to from is always the same, or it is not known; empty where it is seen.
    """
    if not any("approach" in needs for needs in unvaried(result).values()):
        return ""
    if one_surface(result.after.problem):
        return "fixed"
    known = (f.conditions().approach.any() for f in result.after.problem.factors)
    return "same" if all(known) else "unknown"
