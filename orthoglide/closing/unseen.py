"""What the readings cannot detect: too small to show, or never varied, lost motion above all."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Literal

from orthoglide.effects.wording import cause_short
from orthoglide.explanation.free import one_surface
from orthoglide.fit.excited import excited_effects, unmet
from orthoglide.parameters import Parameter
from orthoglide.result import Unseen

if TYPE_CHECKING:
    from orthoglide.closing.closed import Closed

_OF_ONE = "one alone, or several differently"


def unseen(closed: Closed) -> tuple[Unseen, tuple[str, ...]]:
    """Return what the readings cannot detect, and the names of all parameters concerned."""
    hidden = () if closed.posterior is None else closed.posterior.invisible
    excited = {e.name for e in excited_effects(closed.after.problem)} | {*closed.catalogue.base}
    still = tuple(name for name in closed.request.machine.catalogue if name not in excited)
    varied = _unvaried(closed, still)
    found = Unseen(
        effects=_unshown(closed, hidden),
        unvaried=varied,
        one_sided=_one_sided(closed, varied),
        unexcited=still,
    )
    return found, tuple(map(str, (*hidden, *closed.catalogue.expand(list(varied)))))


def _unshown(
    closed: Closed, invisible: tuple[Parameter, ...]
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return effects that would not show at three tolerances, each as a clause with the parameters
    concerned: none where it is all of them; of an effect that was found, its other parameters.
    """
    asked = [] if closed.posterior is None else closed.posterior.about.asked
    every, hidden = (Counter(n.effect for n in names) for names in (asked, invisible))
    several = [one for cause in closed.effects for one in cause.explanations]
    told = {one.catalogue.effect_of(one.name).name for one in several}

    def which(effect: str) -> tuple[str, ...]:
        if hidden[effect] == every[effect]:
            return (_OF_ONE,) if effect in told else ()
        names = (str(n) for n in invisible if n.effect == effect)
        return tuple(name.removeprefix(f"{effect}.") for name in names)

    return tuple((cause_short(closed.catalogue, effect), which(effect)) for effect in hidden)


def _unvaried(closed: Closed, unexcited: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return effects of the machine for which the readings vary no condition, each with those that
    it needs; empty where no cause was looked for.
    """
    problem = closed.after.problem
    several = () if closed.posterior is None else problem.machine.catalogue.effects
    asked = (e for e in several if not (e.of_dial or e.instead_of) and e.name in unexcited)
    return {effect.name: unmet(problem, effect) for effect in asked}


def _one_sided(
    closed: Closed, unvaried: dict[str, tuple[str, ...]]
) -> Literal["", "fixed", "same", "unknown"]:
    """Return why lost motion is not detected, as `Unseen.one_sided`."""
    if not any("approach" in needs for needs in unvaried.values()):
        return ""
    if one_surface(closed.after.problem):
        return "fixed"
    known = (f.conditions().approach.any() for f in closed.after.problem.factors)
    return "same" if all(known) else "unknown"
