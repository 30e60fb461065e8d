"""Whether stored heights and meshes are of one plate and one set of the firmware's numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.effects.plates import every_shape
from orthoglide.geometry import Array, plane_columns
from orthoglide.klipper.firmware import FITTED, shifted
from orthoglide.klipper.probe import PROBE
from orthoglide.klipper.stored import CALIBRATION
from orthoglide.machine_file import Firmware
from orthoglide.notes import Note
from orthoglide.numerals import signed
from orthoglide.observations import ToolCampaign

_BEYOND = 16.3  # chi2 of three numbers that chance exceeds once in a thousand
_WIDE = 0.7  # of the radius of the towers: about as far as plates reach
_BENT = 0.5  # of what a plate's shapes may be: all of it hides that numbers were changed
_WIDTH = 1e-6
_MANY = 2 * FITTED  # touches whose scatter says how noisy they are
_HIGHER, _LEANS, _TOLD = 2e-4, 1.2e-4, 1.1e-4
"""Metres by which two surfaces of one plate may lie apart, and lean at the rim: between printers'
own heights and meshes, which are probed warm and cold, a tenth of a millimetre is common."""


RELATIVE = "meshes_relative"
"""Key of a machine file's provenance: whether the height at one place is taken out of meshes."""


@dataclass(frozen=True)
class _Surface:
    """What touches alone say of the plate, and of the radius and two angles past a plane."""

    name: str  # of the campaign
    plane: Array  # height (metres) and slopes of what was touched, by the present numbers (3,)
    reach: float  # most that a touch is away from the centre, metres
    change: Array  # of the firmware's radius (metres) and angles (radians) (3,)
    spread: Array  # their covariance by the noise of touches (3, 3)
    # what of them is a smooth shape's that is no number's, a column each of a standard deviation
    shapes: Array  # (3, k)
    bends: Array  # what each of these bends the surface by at every touch (n, 3)
    relative: bool  # whether its height says nothing
    turned: float  # how far the plate was turned on its seat, degrees


@dataclass(frozen=True)
class Disagreement:
    """Two campaigns that are not of one plate and one set of numbers."""

    name: str  # of the one that does not fit in
    other: str  # of the first that it does not go with
    note: Note  # both, and what to do


def disagreements(
    firmware: Firmware, campaigns: Sequence[ToolCampaign], *, relative: bool = False
) -> Iterator[Disagreement]:
    """Every mesh by which the plate, or the firmware's radius and angles, would be others.

    A cause in the machine lifts and bends all surfaces alike; between two of them the plate or the
    endstops were moved, the plate was bent, or the firmware's numbers were changed. Of one smooth
    shape, the plate's own or a cause's, other places make other numbers: as much is allowed. A
    plate that is known to be turned takes its shape along: its surface is not compared.

    Args:
        firmware: its present numbers.
        campaigns: that were imported.
        relative: whether the firmware takes the height at one place out of every mesh.
    """
    alike = list[_Surface]()
    for campaign in sorted(campaigns, key=lambda c: c.name != CALIBRATION):
        if (own := _surface(firmware, campaign, relative)) is None:
            continue
        same = (one for one in alike if one.turned == own.turned)
        told = ((one, said) for one in same if (said := _apart(one, own)))
        other, said = next(told, (None, ""))
        if other is None:
            alike.append(own)
            continue
        note = Note(
            f"{own.name}.csv and {other.name}.csv are not of one plate and one set of numbers: "
            f"{said}",
            "apart",
        )
        yield Disagreement(own.name, other.name, note)


def lying_apart(
    firmware: Firmware, campaigns: Sequence[ToolCampaign], *, relative: bool = False
) -> Iterator[Note]:
    """How far surfaces that go together lie apart, where that is more than they repeat to."""
    every = (_surface(firmware, campaign, relative) for campaign in campaigns)
    height = {one.name: float(one.plane[0]) for one in every if one and not one.relative}
    low, high = (pick(height, key=height.__getitem__, default="") for pick in (min, max))
    if height and (apart := height[high] - height[low]) > _TOLD:
        yield Note(
            f"readings of the plate lie up to {apart * 1e3:.2f} mm apart in the middle, {low}.csv "
            f"lowest and {high}.csv highest: a plate may, warm and cold, and they are taken "
            f"together; if something was changed between them, leave the older one out",
            "mesh",
        )


def _apart(one: _Surface, own: _Surface) -> str:
    """In what two surfaces differ, and why they may; empty where they agree."""
    difference, shapes = own.change - one.change, own.shapes - one.shapes
    spread = one.spread + own.spread + shapes @ shapes.T
    if difference @ np.linalg.solve(spread, difference) > _BEYOND:
        most = float(np.abs(own.bends @ difference).max())
        return (
            f"by {own.name}.csv delta_radius would differ by {signed(difference[0] * 1e3, 2)} mm "
            f"and the angles by {np.rad2deg(np.abs(difference[1:]).max()):.2g} degrees, which "
            f"bends the plate by up to {most * 1e3:.2f} mm. The plate was bent or turned "
            f"between them, or the numbers were changed: leave the older of the two out, or probe "
            f"it again; of a plate that was turned say by how much (--turned NAME=DEGREES)"
        )
    higher, *slopes = (own.plane - one.plane).tolist()
    leans = float(np.hypot(*slopes)) * min(one.reach, own.reach)
    if one.relative or own.relative:
        higher = 0.0
    if abs(higher) <= _HIGHER and leans <= _LEANS:
        return ""
    way = "higher" if higher > 0 else "lower"
    lies = f"lies {abs(higher) * 1e3:.2f} mm {way} in the middle, and " if higher else ""
    return (
        f"by {own.name}.csv the plate {lies}leans otherwise by {leans * 1e3:.2f} mm at the rim. "
        f"The numbers were changed after a mesh was probed, or an endstop or the plate was moved "
        f"between them: leave the older of the two out, or probe it again"
    )


def _surface(firmware: Firmware, campaign: ToolCampaign, relative: bool) -> _Surface | None:
    """``None`` where its touches do not tell the six numbers apart."""
    rows = campaign.touching
    below = campaign.command[rows] + firmware.zero - firmware.at_endstop

    def height(numbers: Firmware) -> Array:
        return numbers.points(below + numbers.at_endstop)[:, 2]

    p = firmware.points(below + firmware.at_endstop)
    plane = plane_columns(p)
    bends = np.stack(
        [(height(shifted(firmware, _WIDTH * e)) - height(shifted(firmware, -_WIDTH * e)))
         / (2 * _WIDTH) for e in np.eye(FITTED)[3:]], axis=1,
    )  # fmt: skip
    bends -= plane @ np.linalg.lstsq(plane, bends, rcond=None)[0]
    if len(p) <= FITTED or np.linalg.matrix_rank(bends, tol=1e-3) < bends.shape[1]:
        return None
    rest = campaign.reading[rows] - p[:, 2]
    lies = np.linalg.lstsq(plane, rest, rcond=None)[0]
    # Planes take no part: the bends are past them.
    taken = np.linalg.pinv(bends)
    change = taken @ rest
    left = rest - plane @ lies - bends @ change
    scatter = np.sqrt(left @ left / (len(p) - FITTED)) if len(p) >= _MANY else 0.0
    shapes = every_shape(p[:, :2] / (_WIDE * firmware.delta_radius))
    return _Surface(
        campaign.name,
        -np.asarray(lies),
        float(np.hypot(*p[:, :2].T).max()),
        change,
        max(PROBE, float(scatter)) ** 2 * (taken @ taken.T),
        _BENT * np.stack([taken @ (size * shape) for shape, size in shapes], axis=1),
        bends,
        relative and campaign.name != CALIBRATION,
        float(campaign.turned_by[rows].max(initial=0.0)),
    )
