"""What a verdict says, against what is true of the machine."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

from orthoglide.parameters import plain_and_campaign
from orthoglide.rehearsal.drawing import Drawn

if TYPE_CHECKING:
    from orthoglide.closing import Verdict

_BEYOND = 2.0
"""Times its share by which an effect is off that stands out of the others: one in twenty is."""


def said(verdict: Verdict) -> dict[str, list[dict[str, Any]]]:
    """Causes with their credible sets, and classes of places, ready for JSON."""
    effects = [
        {
            "name": e.name,
            "family": verdict.catalogue.effect_of(e.name).name,
            "members": [
                [one.name, list(one.parameters), one.probability] for one in e.explanations
            ],
        }
        for e in verdict.effects
    ]
    located = [
        {
            "places": [c.name for c in f.members],
            "resembling": list(f.resembling),
            "probability": f.probability,
        }
        for f in verdict.located
    ]
    return {"effects": effects, "located": located}


def is_cause(
    name: str, parameters: Sequence[str], cause: str, family: str, alike: Collection[str] = ()
) -> bool:
    """Whether a named cause is the true one.

    That is itself, a block of its family that holds it, or a member that shows the same.
    """
    of_family = name == family or name.startswith(f"{family}.")
    block = of_family and len(parameters) > 1 and (name == family or cause in parameters)
    return name == cause or block or (of_family and name in alike)


def claims(verdict: Verdict, drawn: Drawn) -> tuple[list[str], list[str], list[str]]:
    """Names of what a verdict claims: causes that are there, places that are, and what is not.

    On a machine of which everything is off, a cause is there if it is off by twice its share.
    """
    named, located, false = list[str](), list[str](), list[str]()
    told = said(verdict)
    for effect in told["effects"]:
        there = any(_is_there(name, parts, drawn) for name, parts, _ in effect["members"])
        (named if there else false).append(effect["name"])
    for found in told["located"]:
        there = bool(drawn.cause) and drawn.cause in (*found["places"], *found["resembling"])
        (located if there else false).append(found["places"][0])
    false += [f"a fault of the data ({b.kind})" for b in verdict.blunders]
    return named, located, false


def _is_there(name: str, parameters: Sequence[str], drawn: Drawn) -> bool:
    # A machine is drawn whole: what a file has for itself goes by its plain name.
    name, *parameters = (plain_and_campaign(n)[0] for n in (name, *parameters))
    if drawn.kind.extra == "effect":
        return is_cause(name, parameters, drawn.cause, drawn.catalogue.effect_of(drawn.cause).name)
    least = _BEYOND * drawn.kind.share
    return any(abs(_size(n, drawn)) > least for n in parameters if drawn.sizes)


def _size(name: str, drawn: Drawn) -> float:
    """True size of a parameter or of a structured member, in tolerances."""
    weights = drawn.catalogue.elementary(name, _setups(drawn))
    along = sum(w * drawn.sizes.get(str(n), 0.0) for n, w in weights.items())
    return along / sum(w**2 for w in weights.values())


def _setups(drawn: Drawn) -> list[str]:
    parameters = map(drawn.catalogue.parameter, drawn.sizes)
    return list(dict.fromkeys(n.setup for n in parameters if n.setup))
