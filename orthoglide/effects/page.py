"""The page of effects, made from the catalogue: ``python -m orthoglide.effects.page``."""

from __future__ import annotations

from orthoglide.effects.catalogue import CATALOGUE, catalogue_of
from orthoglide.effects.effect import Effect
from orthoglide.effects.wording import confirm_words
from orthoglide.layout import LinearDelta

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

_HEAD = f"""# The catalogue of effects

Look up an effect by its name in a report: what to look at, what confirms it, and what it is called
in files. Printed by `python -m orthoglide.effects.page`;
[Contributing](../CONTRIBUTING.md#add-an-effect-in-four-steps) says how to add one.

- **Tolerance**: the standard deviation expected of a carefully built machine, and the prior; your
  own goes into `[tolerance]` of the [machine file](files.md).
- **Parameters** carry a leg and, where a second letter follows, the direction of the error
  ([conventions](conventions.md#signs-of-errors)); those of dials and plates the name of the setup.
- **Together**: patterns that symmetry makes likely, one parameter each.
- {" and ".join(f"`{name}`" for name in CATALOGUE.base)} are identified always.
"""


def effects_page() -> str:
    """The page as Markdown."""
    parts = [_HEAD, _overview()]
    for group, heading in GROUPS.items():
        effects = [effect for effect in EFFECTS if effect.group == group]
        if effects:
            parts += [f"## {heading}\n", *(_section(effect) for effect in effects)]
    return "\n".join(parts)


def _overview() -> str:
    rows = ["| effect | unit | tolerance | in a sentence |", "|---|---|---|---|"]
    rows += [
        f"| [`{effect.name}`](#{effect.name}) | {effect.unit.name} | {effect.tolerance:g} | "
        f"{effect.sentence}{'' if effect.name in CATALOGUE else ' (not on an Orthoglide)'} |"
        for group in GROUPS
        for effect in EFFECTS
        if effect.group == group
    ]
    return "\n".join(rows) + "\n"


def _section(effect: Effect) -> str:
    names = [f"`{n}`" for n in effect.parameters(("SETUP",))]
    catalogue = CATALOGUE if effect.name in CATALOGUE else _DELTA_CATALOGUE
    members = [
        f"`{n}`"
        for n in catalogue.structured_members(effect.name, _SETUPS if effect.of_dial else ())
    ]
    first = next(iter(effect.parameters(("SETUP",))))
    lines = [
        f"### {effect.name}",
        "",
        f"- Look at: {effect.look_at}{'' if effect.look_at.endswith('?') else '.'}",
        f"- Tolerance: {effect.because}.",
        f"- Confirmed, at one tolerance of `{first}`: "
        f"{confirm_words(effect, first, effect.tolerance_si)}.",
        f"- Parameters: {', '.join(names)}.",
    ]
    if members:
        lines.append(f"- Together: {', '.join(members)}.")
    if effect.name not in CATALOGUE:
        lines.append("- On linear deltas and machines of kind `legs`, not on an Orthoglide.")
    if effect.needs:
        lines.append(f"- Depends on: {', '.join(sorted(effect.needs))}.")
    lines.append(f"- Corrected by: {_correction(effect)}.")
    return "\n".join(lines) + "\n"


def _correction(effect: Effect) -> str:
    if effect.of_dial:
        return "nothing, as it is no error of the machine"
    setting_names = {"zero": "zero", "scale": "scale factor", "backlash": "backlash setting",
              "bar_length": "bar length"}  # fmt: skip
    corrections = ["compensated commands"]
    if effect.urdf:
        corrections.append("a calibrated URDF")
    if effect.controller in setting_names:
        corrections.append(f"the controller's {setting_names[effect.controller]}")
    return ", ".join(corrections) if effect.at_rest else "none of the controller's numbers"


_SETUPS = ("a", "b")  # any two: what several dials can have in common has no setup's name


if __name__ == "__main__":
    print(effects_page(), end="")
