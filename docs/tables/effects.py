"""The page of effects, from the catalogue.

``python docs/tables/effects.py`` prints ``docs/effects.md``.
"""

from __future__ import annotations

from textwrap import fill

from orthoglide.effects.catalogue import CATALOGUE, catalogue_of
from orthoglide.effects.effect import Effect
from orthoglide.effects.wording import value_words
from orthoglide.layout import LinearDelta
from orthoglide.text import sentence

GROUPS = {
    "drive": "Drives",
    "structure": "Rails, brackets, bars and links",
    "temperature": "Temperature",
    "load": "Load",
    "dial": "Dials",
    "plate": "Plates",
    "part": "Printed parts",
}
"""Headings of the page, by group of the catalogue, in their order."""

_DELTA_CATALOGUE = catalogue_of(LinearDelta.names)
EFFECTS = (*CATALOGUE.values(), *(e for e in _DELTA_CATALOGUE.values() if e.name not in CATALOGUE))
"""Effects of the page: those of the Orthoglide, then those that only other layouts have."""

_SETTINGS = {
    "zero": "zeros",
    "scale": "scales",
    "backlash": "backlash",
    "bar_length": "bar lengths",
}
"""Settings of a controller, by the `controller` of an effect."""

_HEAD = """# The catalogue of effects

Look up an effect by its name in a report or a file. Each is worded at one tolerance of its first
parameter, which shows the sign. The report has the test that confirms a cause, and
[Contributing](../CONTRIBUTING.md#add-an-effect-in-four-steps) says how to add an effect. Printed by
`python docs/tables/effects.py`.

- **Tolerance**: the standard deviation expected of a carefully built machine, and the prior; your
  own goes into the [machine file](files.md).
- **Parameters** carry a leg and, where a second letter follows, the direction of the error
  ([conventions](conventions.md#signs-of-errors)); those of dials and plates the name of the setup.
- **Patterns** are candidates too, with one parameter each: `.common` is the same value everywhere.
  Where a second letter follows, `.cyclic` is + for x.y, y.z, z.x and − for y.x, z.y, x.z, and
  `.xy.symmetric` or `.xy.antisymmetric` are x.y and y.x with equal or opposite signs.
"""


def markdown() -> str:
    """Return the page as Markdown."""
    parts = [_HEAD + _corrections()]
    for group, heading in GROUPS.items():
        effects = [effect for effect in EFFECTS if effect.group == group]
        if effects:
            parts += [f"## {heading}\n", *(_section(effect) for effect in effects)]
    return "\n".join(parts)


def _corrections() -> str:
    """Return what corrects which effects, as the last items of the head's list."""
    at_rest = [effect for effect in EFFECTS if effect.at_rest and not effect.of_dial]
    urdf = ", ".join(f"`{effect.name}`" for effect in at_rest if effect.urdf)
    settings = ", ".join(
        f"{_SETTINGS[effect.controller]} (`{effect.name}`)"
        for effect in at_rest
        if effect.controller in _SETTINGS
    )
    corrections = (
        "- **Corrections**: compensated commands correct every effect of drives, rails, brackets, "
        f"bars and links; a calibrated URDF contains {urdf}; a controller may have settings for "
        f"{settings}."
    )
    return f"{fill(corrections, 100, subsequent_indent='  ')}\n"


def _section(effect: Effect) -> str:
    names = [f"`{n}`" for n in effect.parameters(("SETUP",))]
    first = next(iter(effect.parameters(("SETUP",))))
    lines = [
        f"### {effect.name}",
        "",
        sentence(value_words(effect, first, effect.tolerance_si)),
        "",
        f"- Parameters: {', '.join(names)}.",
        f"- Tolerance {effect.tolerance:g}{effect.unit.behind}: {effect.because}.",
    ]
    if effect.name not in CATALOGUE:
        lines.append("- On linear deltas and machines of kind `legs`, not on an Orthoglide.")
    if effect.needs:
        lines.append(f"- Depends on: {', '.join(sorted(effect.needs))}.")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
