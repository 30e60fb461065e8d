"""The page of effects, made from the catalogue: ``python -m orthoglide.effects.page``."""

from __future__ import annotations

from orthoglide.effects.catalogue import BASE_FAMILIES, CATALOGUE, structured
from orthoglide.effects.effect import Family

GROUPS = {
    "drive": "Drives",
    "structure": "Rails, brackets, bars and links",
    "temperature": "Temperature",
    "load": "Load",
    "dial": "Dials",
}
"""Headings of the page, by group of the catalogue, in their order."""

_HEAD = f"""# The catalogue of effects

What real machines have and the nominal one lacks. This page is printed by
`python -m orthoglide.effects.page`, and a test fails when it is stale: change the catalogue, not
the page. How to add an effect is told in [CONTRIBUTING](../CONTRIBUTING.md).

- **Tolerance** is the standard deviation to expect of a carefully built machine. It acts as the
  prior of the parameter; your own goes into `[tolerance]` of the [machine file](files.md).
- **Parameters** carry a leg (`x`, `y`, `z`) and, where a second letter follows, the direction of
  the error ([conventions](conventions.md)); those of dials carry the name of the setup.
- **Together** lists patterns that parts of the machine's symmetry make likely, one parameter each.
- {" and ".join(f"`{name}`" for name in BASE_FAMILIES)} are the parameters of the papers, and every
  identification begins with them.
"""


def effects_page() -> str:
    """The page as Markdown."""
    parts = [_HEAD, _overview()]
    for group, heading in GROUPS.items():
        families = [f for f in CATALOGUE.values() if f.group == group]
        if families:
            parts += [f"## {heading}\n", *(_section(f) for f in families)]
    return "\n".join(parts)


def _overview() -> str:
    rows = ["| effect | unit | tolerance | in a sentence |", "|---|---|---|---|"]
    rows += [
        f"| [`{f.name}`](#{f.name}) | {f.unit.name} | {f.tolerance:g} | {f.sentence} |"
        for group in GROUPS
        for f in CATALOGUE.values()
        if f.group == group
    ]
    return "\n".join(rows) + "\n"


def _section(family: Family) -> str:
    names = [f"`{n}`" for n in family.parameters()] or [f"`{family.name}.SETUP`"]
    members = [f"`{n}`" for n in structured(family.name, _SETUPS if family.group == "dial" else ())]
    lines = [
        f"### {family.name}",
        "",
        f"{_capital(family.sentence)}.",
        "",
        f"- Look at: {family.look_at}.",
        f"- Tolerance {family.tolerance:g} {_unit(family)}: {family.because}.",
        f"- Parameters: {', '.join(names)}.",
    ]
    if members:
        lines.append(f"- Together: {', '.join(members)}.")
    return "\n".join(lines) + "\n"


_SETUPS = ("a", "b")  # any two: what several dials can have in common has no setup's name


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _unit(family: Family) -> str:
    return "(a ratio)" if family.unit.name == "1" else family.unit.name


if __name__ == "__main__":
    print(effects_page(), end="")
