"""Designs, comparisons and answers as rows of text for the command line."""

from __future__ import annotations

from collections.abc import Sequence

from orthoglide.effects import Catalogue
from orthoglide.planning.designs import Design
from orthoglide.planning.observability import Observability
from orthoglide.planning.repeats import TCP, Repeats
from orthoglide.units import MM

_LEGEND = (
    "O1 to O5, the larger the better: all unknowns, evenness, worst seen, O2 times O3, mean seen."
)


def index_rows(compared: Sequence[tuple[str, Observability]]) -> list[str]:
    """A table of observability indices: campaigns or protocols by name."""
    head = f"{'':<15}{'readings':>9}{'seen':>7}" + "".join(f"{f'O{k}':>9}" for k in range(1, 6))
    return [
        head,
        *(
            f"{name:<15}{o.readings:>9}{f'{o.rank}/{o.unknowns}':>7}"
            + "".join(f"{v:>9.2g}" for v in o.indices.values())
            for name, o in compared
        ),
        _LEGEND,
    ]


def pair_rows(found: Design) -> list[str]:
    """What a discriminating design tells apart least, and what it never does."""
    lines = []
    for pair in found.closest[:5]:
        against = f"from {pair.other}" if pair.other else "from no effect at all"
        lines.append(f"{pair.one} {against}: {pair.sigmas:.1f} sigma at tolerance")
    for pair in found.never:
        against = f"{pair.one} and {pair.other}" if pair.other else pair.one
        lines.append(f"{against}: no few readings within reach tell at tolerance")
    return lines


def repeats_row(answer: Repeats, catalogue: Catalogue) -> str:
    """An answer to "how often"."""
    unit = MM if answer.what == TCP else catalogue.effect_of(answer.what).unit
    wanted, sigma, floor = (v / unit.si for v in (answer.wanted, answer.sigma, answer.floor))
    if answer.repeats is None:
        return (
            f"{answer.what}: sigma {wanted:.3g}{unit.behind} is out of reach of repeats: "
            f"{sigma:.3g} with one visit, {floor:.3g} with any number"
        )
    return (
        f"{answer.what}: sigma {wanted:.3g}{unit.behind} takes {answer.repeats} "
        f"{'visit' if answer.repeats == 1 else 'visits'} to every station (then {sigma:.3g})"
    )
