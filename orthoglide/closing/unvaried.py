"""What readings cannot show as nothing in them varies it: lost motion above all."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Literal

from orthoglide.effects.wording import cause_short
from orthoglide.explanation.free import one_surface
from orthoglide.fit.excited import unmet

if TYPE_CHECKING:
    from orthoglide.closing.closed import Closed


_OF_ONE = "one alone, or several differently"


def unshown(closed: Closed) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Effects that the readings would not show at three tolerances: in words, and which of an
    effect's parameters where it is not all of them; of one that is told, all alike, only others.
    """
    asked = [] if closed.posterior is None else closed.posterior.about.asked
    every, hidden = (Counter(n.effect for n in names) for names in (asked, closed.invisible))
    several = [one for cause in closed.effects for one in cause.explanations]
    told = {one.catalogue.effect_of(one.name).name for one in several}

    def which(effect: str) -> tuple[str, ...]:
        if hidden[effect] == every[effect]:
            return (_OF_ONE,) if effect in told else ()
        names = (str(n) for n in closed.invisible if n.effect == effect)
        return tuple(name.removeprefix(f"{effect}.") for name in names)

    return tuple((cause_short(closed.catalogue, effect), which(effect)) for effect in hidden)


def unvaried(closed: Closed) -> dict[str, tuple[str, ...]]:
    """Effects of the machine that nothing in the readings varies, each with what would:
    ``approach``, ``load`` ...; empty where no cause was looked for.
    """
    problem = closed.after.problem
    several = () if closed.posterior is None else problem.machine.catalogue.effects
    asked = (e for e in several if not (e.of_dial or e.instead_of) and e.name in closed.unexcited)
    return {effect.name: unmet(problem, effect) for effect in asked}


def one_sided(closed: Closed) -> Literal["", "fixed", "same", "unknown"]:
    """Why lost motion is not seen: all that was read has but one side, the side that places were
    come to from is always the same, or it is not known; empty where it is seen.
    """
    if not any("approach" in needs for needs in unvaried(closed).values()):
        return ""
    if one_surface(closed.after.problem):
        return "fixed"
    known = (f.conditions().approach.any() for f in closed.after.problem.factors)
    return "same" if all(known) else "unknown"
