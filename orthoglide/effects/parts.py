"""What is wrong with the size of a part that was printed and measured with a calliper.

A part moves no virtual joint: where it is larger, the distances that are read on it are longer.
"""

from __future__ import annotations

from orthoglide.effects.effect import Effect
from orthoglide.effects.words import Words, mm, more, percent
from orthoglide.parameters import Parameter
from orthoglide.units import ONE

_LONG = 0.1  # metres: a length that a calliper and a rule both reach


def _in(p: Parameter) -> str:
    return f" in {p.setup}" if p.setup else ""


PART_SIZE = Effect(
    "part_size",
    ONE,
    0.01,
    because="a scale set in the slicer, or a calliper's jaws, are off by a hundredth",
    sentence="the printed part, or the calliper, is off in size beyond the plastic's shrinkage",
    look_at="the calliper against a gauge block or a second calliper, and the slicer's scale",
    words=Words(
        lambda p, v: (
            f"the printed part, or the calliper, makes distances{_in(p)} {percent(v)} "
            f"{more(v, 'longer', 'shorter')} than the plastic's shrinkage does"
        ),
        lambda p: "the printed part, or the calliper, is off in size beyond the shrinkage",
        "the printed parts, or the calliper, are off in size beyond the shrinkage",
        percent,
        lambda p, v: (
            f"measure a gauge block, or 100 mm of a good rule, with the calliper: expect "
            f"{mm(_LONG * v)} {more(v)}, or look for that in the slicer's scale"
        ),
    ),
    group="part",
    part=lambda length, size: (1 + size) * length,
)

OF_TOWERS = (PART_SIZE,)
