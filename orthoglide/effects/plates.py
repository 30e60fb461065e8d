"""Errors of a plate that the tool touches, and of the size of a part that it printed.

Neither moves a virtual joint. Where a plate is higher, the tool stands lower above it; its height
and two slopes are fitted with every setup, and its effects are the residual shape. Where a part is
larger, the distances that are read on it are longer.
"""

from __future__ import annotations

from orthoglide.effects.effect import Effect
from orthoglide.effects.words import Words
from orthoglide.geometry import Array
from orthoglide.units import MM, ONE

PLATE_SHAPE_SD = 1e-4
"""Standard deviation of a bowl, a saddle or three lobes, metres."""

PLATE_BOW = Effect(
    "plate_bow",
    MM,
    PLATE_SHAPE_SD / MM.si,
    because="a heated bed is flat to a tenth or two",
    sentence="the plate is a bowl or a dome",
    look_at="the plate with a straight edge across its middle",
    words=Words(
        "the plate{of_setup} is a {bowl|dome}: its rim stands {size} {higher|lower} than its "
        "middle",
        "the plate{of_setup} is a bowl or a dome",
        "the plates are bowls or domes",
        confirm="lay a straight edge across the plate{of_setup}: expect a gap of {size} under its "
        "{middle|ends}",
    ),
    group="plate",
    plate=(("", lambda x, y: x**2 + y**2),),
)

PLATE_TREFOIL = Effect(
    "plate_trefoil",
    MM,
    PLATE_SHAPE_SD / MM.si,
    because="a bed on three screws, or heated, warps by a tenth in three lobes",
    sentence="the plate has three high and three low sides",
    look_at="the plate turned by 60 degrees on its seat: a pattern of its own turns with it",
    words=Words(
        "the plate{of_setup} has three lobes {size} high at its rim, one of them toward "
        "{high_side} degrees",
        "the plate{of_setup} has three high and three low sides",
        "the plates have three high and three low sides",
        confirm="turn the plate{of_setup} by 60 degrees and measure again: expect its three lobes "
        "of {size} at the rim to turn with it: low where it was high, toward {high_side} degrees",
    ),
    group="plate",
    paired=True,
    lobes=3,
    plate=(
        ("cos", lambda x, y: x**3 - 3 * x * y**2),
        ("sin", lambda x, y: 3 * x**2 * y - y**3),
    ),
)

PLATE_SADDLE = Effect(
    "plate_saddle",
    MM,
    PLATE_SHAPE_SD / MM.si,
    because="a bed held at its corners, or a bent sheet, twists by a tenth",
    sentence="the plate is a saddle",
    look_at="the plate with a straight edge in several directions across its middle",
    words=Words(
        "the plate{of_setup} is a saddle: its rim stands {size} high toward {high_side} degrees, "
        "and low square to that",
        "the plate{of_setup} is a saddle",
        "the plates are saddles",
        confirm="lay a straight edge across the plate{of_setup} toward {high_side} degrees: expect "
        "a gap of {size} under its middle",
    ),
    group="plate",
    paired=True,
    lobes=2,
    plate=(("cos", lambda x, y: x**2 - y**2), ("sin", lambda x, y: 2 * x * y)),
)

PLATE_RING = Effect(
    "plate_ring",
    MM,
    0.05,
    because="a bed that is held or heated unevenly has its rim turned up or down by half a tenth",
    sentence="the plate has a hollow or a ridge all around, between its middle and its rim",
    look_at="the plate with a straight edge from its middle to its rim",
    words=Words(
        "the plate{of_setup} has a {hollow|ridge} {size} {deep|high} all around, between its "
        "middle and its rim",
        "the plate{of_setup} has a hollow or a ridge between its middle and its rim",
        "the plates have hollows or ridges between their middles and their rims",
        confirm="lay a straight edge on the plate{of_setup} from its middle to its rim: expect "
        "{a gap of|it to rock on a ridge of} {size} half way",
    ),
    group="plate",
    plate=(("", lambda x, y: 4 * (x**2 + y**2) * (x**2 + y**2 - 1)),),
)

PART_SIZE = Effect(
    "part_size",
    ONE,
    0.01,
    because="a scale set in the slicer, or a calliper's jaws, are off by a hundredth",
    sentence="the printed part, or the calliper, is off in size beyond the plastic's shrinkage",
    look_at="the calliper against a gauge block or a second calliper, and the slicer's scale",
    words=Words(
        "the printed part, or the calliper, makes distances{in_setup} {size} {longer|shorter} than "
        "the plastic's shrinkage does",
        "the printed part, or the calliper, is off in size beyond the shrinkage",
        "the printed parts, or the calliper, are off in size beyond the shrinkage",
        confirm="measure a gauge block, or 100 mm of a good rule, with the calliper: expect "
        "{mm:0.1} {more|less}, or look for that in the slicer's scale",
    ),
    group="part",
    part=lambda length, size: (1 + size) * length,
)

PILLAR_WIDTH = Effect(
    "pillar_width",
    MM,
    3.0,
    because="pillars are 3 to 10 mm wide, and one or two of their halves are taken off or added",
    sentence="distances were measured outside pillars where centres were meant, or the reverse",
    look_at="how these distances were measured: which widths were taken off or added",
    words=Words(
        "the distances{in_setup} are all {size} too {long|short}, as by the width of a pillar",
        "the distances{in_setup} are off by the width of a pillar",
        "all distances are off by the width of a pillar",
        confirm="measure one of the distances{in_setup} from centre to centre: expect {size} "
        "{less|more} than was given",
    ),
    group="part",
    part=lambda length, width: length + width,
    per_setup=True,
)

EFFECTS = (PLATE_BOW, PLATE_TREFOIL)
DELTA_EFFECTS = (PLATE_SADDLE, PLATE_RING, PART_SIZE, PILLAR_WIDTH)


def residual_plate_shapes(position: Array, scale: float = 1.0) -> list[tuple[Array, float]]:
    """Return small shapes of degree 2 to 4 at positions on the plate over its radius ``(n, 2)``,
    with their standard deviations, for a machine's size relative to a workshop's.

    A plate is never flat apart from a bowl, a saddle and three lobes, and its residual shape is no
    cause in the machine. Small saddles belong to it, so that only larger ones are causes. Each
    degree of the polynomial halves the expected size.
    """
    x, y = position.T
    radius_squared = x**2 + y**2
    quadratics = [saddle(x, y) for saddle in PLATE_SADDLE.shapes.values()]
    by_degree = {
        2: quadratics,
        3: (x * (3 * radius_squared - 2), y * (3 * radius_squared - 2)),
        4: (
            6 * radius_squared**2 - 6 * radius_squared + 1,
            *(shape * (4 * radius_squared - 3) for shape in quadratics),
            x**4 - 6 * x**2 * y**2 + y**4,
            4 * x * y * (x**2 - y**2),
        ),
    }
    return [
        (shape, scale * PLATE_SHAPE_SD / 2 ** (degree - 1))
        for degree, shapes in by_degree.items()
        for shape in shapes
    ]
