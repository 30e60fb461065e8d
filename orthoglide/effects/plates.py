"""What a plate does wrong whose height a tool measures by touching it.

A plate moves no virtual joint: where it is higher, the tool stands lower above it. Its height and
two slopes are fitted with every setup; here is what is left of its shape.
"""

from __future__ import annotations

from orthoglide.effects.effect import Effect
from orthoglide.effects.words import Words, mm, more
from orthoglide.parameters import Parameter
from orthoglide.units import MM

PLATE_BOW = Effect(
    "plate_bow",
    MM,
    0.1,
    because="a heated bed is flat to a tenth or two",
    sentence="the plate is a bowl or a dome",
    look_at="the plate with a straight edge across its middle",
    words=Words(
        lambda p, v: (
            f"{_plate(p)} is a {more(v, 'bowl', 'dome')}: its rim stands {mm(v)} "
            f"{more(v, 'higher', 'lower')} than its middle"
        ),
        lambda p: f"{_plate(p)} is a bowl or a dome",
        "the plates are bowls or domes",
        mm,
        lambda p, v: (
            f"lay a straight edge across {_plate(p)}: expect a gap of {mm(v)} under its "
            f"{more(v, 'middle', 'ends')}"
        ),
    ),
    group="plate",
    plate=(("", lambda x, y: x**2 + y**2),),
)

PLATE_TREFOIL = Effect(
    "plate_trefoil",
    MM,
    0.1,
    because="a bed on three screws, or heated, warps by a tenth in three lobes",
    sentence="the plate has three high and three low sides",
    look_at="the plate turned by 60 degrees on its seat: a pattern of its own turns with it",
    words=Words(
        lambda p, v: (
            f"{_plate(p)} has three lobes {mm(v)} high, one of them toward "
            f"{_lobe(p.direction, v)} degrees"
        ),
        lambda p: f"{_plate(p)} has three high and three low sides",
        "the plates have three high and three low sides",
        mm,
        lambda p, v: (
            f"turn {_plate(p)} by 60 degrees and measure again: expect its three lobes "
            f"of {mm(v)} to turn with it: low toward {_lobe(p.direction, v)} degrees"
        ),
    ),
    group="plate",
    plate=(
        ("cos", lambda x, y: x**3 - 3 * x * y**2),
        ("sin", lambda x, y: 3 * x**2 * y - y**3),
    ),
)


def _plate(p: Parameter) -> str:
    return f"the plate of {p.setup}" if p.setup else "the plate"


def _lobe(part: str, value: float) -> int:
    """Direction of a lobe from +x, counter-clockwise, degrees."""
    first = 0 if part == "cos" else 30
    return first if value >= 0 else first + 60


EFFECTS = (PLATE_BOW, PLATE_TREFOIL)
