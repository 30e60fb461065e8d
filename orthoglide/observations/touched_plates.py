"""Consistency of lists of touches: whether a plate was moved or replaced between two of them.

The place and the height of a touch are those of a delta's controller. Heights are compared at equal
commanded places, so errors of the machine cancel; the list with more touches is interpolated at the
touches of the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.geometry import Array, fit_plane, plane_columns, polynomial_columns
from orthoglide.machine_file import DeltaKinematics
from orthoglide.notes import Note
from orthoglide.numerals import plain
from orthoglide.observations.readings import Readings

LEAST_MOVE = 1e-4
"""Smallest move that is reported on a machine of usual size, metres: the thickness of paper."""

_MAX_DIFFERENCE, _MAX_TILT, _MAX_SHAPE = 2e-4, 6e-5, 5e-5
"""Metres by which two lists may differ at three quarters of the places that both touched: in
height, by a tilt, and with many places by a smooth shape. Of 17 pairs on owners' printers, probed
warm and cold, none differs by more than 0.11, 0.036 and 0.015 mm; an endstop that moved by 0.3 mm
tilts a plate by 0.07 mm or more. A quarter may differ by more: a list with one wrong touch of seven
has to stay, as the other list is what shows that touch."""
_MIN_COMMON_PLACES = 4  # places that establish a difference: one more than a plane has unknowns
_SIGNIFICANT_SIGMAS = 3.0
_USUAL_NOISE = 2.5e-5  # metres, of a difference of two touches
_TRIMMING_STEPS = 5  # of a fit to the places that agree; most settle after two
_MIN_SHAPE_PLACES = 6  # places for a shape beside a plane: twice its unknowns
_LARGE_SHAPE, _MIN_SHAPE_RATIO = 4e-5, 3.0
"""Root mean square of differences beside a plane, metres, more than of any of those 17 pairs (0.032
mm), and the ratio by which it falls if the places of a mirrored or turned list are corrected."""

_OTHER_SIGN = "taken with heights of the other sign"
_SYMMETRIES = {
    "mirrored in x": np.diag([-1.0, 1.0, 1.0]),
    "mirrored in y": np.diag([1.0, -1.0, 1.0]),
    "taken with x and y exchanged": np.eye(3)[[1, 0, 2]],
    _OTHER_SIGN: np.diag([1.0, 1.0, -1.0]),
    **{
        f"turned by {angle} degrees": np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        for angle in (90, 120, 180, 240, 270)
        for c, s in [(np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle)))]
    },
}
"""What the first of two lists may be, with the matrix from its points to those of the other, points
being rows: other orders of rows and columns of a grid, heights counted downward, and turns of the
towers' names or of a plate, counter-clockwise from above."""

_MAX_BESIDE_BOWL = 0.1  # share of a difference's variance that a bowl may leave unexplained
_MIN_SMOOTHED = 12  # places for a surface of second order: twice its unknowns

_REFERENCE_DEGREE = 3  # of the smooth surface of a long list: lobes of a bed are of the third
_MIN_REFERENCE, _MAX_JUDGED = 20, 30
"""Touches of a list to which shorter ones are compared, twice the unknowns of its surface, and
those from which a list has a surface of its own that shows a wrong touch."""
_MIN_JUDGED = 7  # touches that show a wrong one: three more than a bowl has unknowns
_MIN_FREE = 0.1  # share of an error that a bowl must leave: one in the middle looks like a bowl
_OUTLIER_RATIO = 6.0  # distance of a wrong touch over the scatter of all others
_USUAL_COUNT = 3  # residuals of the usual noise that count as well, as the others may be few


@dataclass(frozen=True)
class PlateMove:
    """A plate that lies elsewhere than in other readings, at equal commands."""

    setup: str  # name of the readings that touched it
    higher: float  # rise of its middle, metres; 0 if insignificant
    rise: float  # largest rise of its rim beyond that, metres; 0 if insignificant
    toward: float  # direction of that, degrees from x toward y
    reference: str = "before"  # what it is compared with, a phrase

    @property
    def words(self) -> str:
        """Clause with direction and size of the move, without a cause."""
        clauses = []
        if self.higher:
            size, side = plain(abs(self.higher) * 1e3, 2), "higher" if self.higher > 0 else "lower"
            clauses.append(f"lies {size} mm {side} than {self.reference}")
        if self.rise:
            size, where = plain(self.rise * 1e3, 2), f"{self.toward:.0f} degrees"
            clauses.append(
                f"is tilted against {self.reference}: its rim rises by {size} mm toward {where} (x "
                f"is 0, y is 90)"
            )
        return f"at equal commands the plate of {self.setup} {' and '.join(clauses)}"


def disagreements(
    kinematics: DeltaKinematics | None, campaigns: Sequence[Readings], *, relative: bool
) -> Iterator[tuple[str, str, Note]]:
    """Yield the names of two lists of touches whose heights differ at common places, and a note.

    Its kind is ``moved`` if the difference is a plane: both show one plate, which lies elsewhere.
    Otherwise it is ``apart``: the plate or the controller's numbers differ.

    Args:
        kinematics: of the controller; without them nothing is compared.
        campaigns: readings; each list is compared with those before it that agree, up to the first
            that it contradicts.
        relative: whether the heights of a list have no common zero with those of another.
    """
    if kinematics is None:
        return
    sound, agreed = list(campaigns), list[Readings]()
    for k, row, _ in outlying_touches(kinematics, campaigns):
        sound[k] = sound[k].subset(np.delete(np.arange(len(sound[k])), row))
    for campaign in sound:
        for other in agreed:
            places, difference = _differences(kinematics, campaign, other, relative)
            note = _symmetry_note(kinematics, campaign, other, places, difference)
            if note := note or _note(campaign.name, other.name, places, difference):
                yield campaign.name, other.name, note
                break
        else:
            agreed.append(campaign)


def outlying_touches(
    kinematics: DeltaKinematics | None, lists: Sequence[Readings]
) -> Iterator[tuple[int, int, float]]:
    """Yield the list, the row and the height of each touch of a short list that lies off the plate
    of the longest one, metres.

    Few touches have no surface of their own that would show a speck under one of them. The plate of
    each list may lie elsewhere and be a bowl against that of the longest.
    """
    counts = [int(c.touching.sum()) for c in lists]
    if kinematics is None or max(counts, default=0) < _MIN_REFERENCE:
        return
    longest = lists[int(np.argmax(counts))]
    q, heights = _touched_heights(kinematics, longest)
    scale = float(np.abs(q).max())
    basis, root = np.linalg.qr(polynomial_columns(q / scale, _REFERENCE_DEGREE))
    if np.linalg.matrix_rank(root, tol=1e-6) < len(root):
        return
    for k, campaign in enumerate(lists):
        if counts[k] < min(len(q), _MAX_JUDGED) and _turned(campaign) == _turned(longest):
            p, height = _touched_heights(kinematics, campaign)
            columns = np.linalg.solve(root.T, polynomial_columns(p / scale, _REFERENCE_DEGREE).T).T
            # Elsewhere the surface is known less well than a touch.
            known = np.flatnonzero(np.sum(columns**2, axis=1) < 1)
            difference = height - columns @ (basis.T @ heights)
            if outlier := _outlying_place(p[known], difference[known]):
                row = np.flatnonzero(campaign.touching)[known[outlier[0]]]
                yield k, int(row), outlier[1]


def _outlying_place(places: Array, difference: Array) -> tuple[int, float] | None:
    """Return the place at which two lists differ otherwise than at all others, and by how much;
    ``None`` if there is none.
    """
    if len(places) < _MIN_JUDGED:
        return None
    columns = np.column_stack([plane_columns(places), np.sum(places**2, axis=1)])
    basis = np.linalg.qr(columns)[0]
    residual = difference - basis @ (basis.T @ difference)
    free = 1 - np.sum(basis**2, axis=1)  # share of an error that the bowl leaves
    gain = np.where(free > _MIN_FREE, residual**2 / free.clip(_MIN_FREE), 0.0)
    k = int(np.argmax(gain))
    others = float(residual @ residual - gain[k]) + _USUAL_COUNT * _USUAL_NOISE**2
    others /= len(places) - columns.shape[1] - 1 + _USUAL_COUNT
    return (k, float(residual[k] / free[k])) if gain[k] > _OUTLIER_RATIO**2 * others else None


def _turned(campaign: Readings) -> float:
    """Return by how much the plate was turned on its seat, degrees."""
    return float(campaign.turned_by[campaign.touching].max(initial=0.0))


def _symmetry_note(
    kinematics: DeltaKinematics, campaign: Readings, other: Readings,
    places: Array, difference: Array,
) -> Note | None:  # fmt: skip
    """Return a note on two lists whose heights agree only if one is mirrored or turned; ``None`` if
    they agree as they are, or in no other way.
    """
    size = _shape_size(places, difference)
    if not _LARGE_SHAPE < size < np.inf:
        return None
    shapes = {
        way: _shape_size(*_differences(kinematics, campaign, other, False, symmetry))
        for way, symmetry in _SYMMETRIES.items()
    }
    agreeing = min(size / _MIN_SHAPE_RATIO, _LARGE_SHAPE)
    ways = [way for way, least in shapes.items() if least <= agreeing]
    if not ways or (ways == [_OTHER_SIGN] and _is_bowl(places, difference)):
        return None  # a bowl against a dome may be another plate or radius as well
    return Note(
        f"{campaign.name}.csv and {other.name}.csv are not of one plate and one set of numbers: "
        f"beside a plane their heights differ by {plain(size * 1e3, 3)} mm rms, and by "
        f"{plain(min(shapes.values()) * 1e3, 3)} mm if {campaign.name}.csv is "
        f"{' or '.join(ways)}. Correct its sign or the order of its rows and columns, or probe it "
        f"again; of a plate that was turned say by how much (turned_deg, or --turned NAME=DEGREES "
        f"on import)",
        "apart",
    )


def _shape_size(places: Array, difference: Array) -> float:
    """Return the root mean square of differences beside a plane, metres; infinite for too few."""
    if len(places) < _MIN_SHAPE_PLACES:
        return np.inf
    return float(np.sqrt(np.mean(fit_plane(places, difference)[1] ** 2)))


def _bowl(places: Array, difference: Array) -> Array:
    """Return the bowl in a difference, over its middle ``(n,)``, metres."""
    square = np.sum((places - places.mean(axis=0)) ** 2, axis=1)
    bowl = fit_plane(places, square)[1]
    return square * float(difference @ bowl) / max(float(bowl @ bowl), 1e-12)


def _is_bowl(places: Array, difference: Array) -> bool:
    """Return whether a plane and a bowl explain most of a difference."""
    shape, bowl = (fit_plane(places, h)[1] for h in (difference, _bowl(places, difference)))
    return bool(np.var(shape - bowl) < _MAX_BESIDE_BOWL * np.var(shape))


def _note(name: str, other: str, places: Array, difference: Array) -> Note | None:
    """Return a note on two lists whose heights differ; ``None`` if they agree."""
    if not len(difference):
        return None
    centred = places - places.mean(axis=0)
    plane, tilt_limit = _trimmed_plane(centred, difference)
    (height, *slope), (_, shape) = plane, fit_plane(centred, difference)
    differs = _upper_quartile(difference) > _MAX_DIFFERENCE
    differs |= _upper_quartile(centred @ slope) > tilt_limit
    if len(difference) >= _MIN_SMOOTHED:
        x, y = centred.T
        columns = np.column_stack([plane_columns(centred), x**2, x * y, y**2])
        shape = columns @ np.linalg.lstsq(columns, shape, rcond=None)[0]
        differs |= _upper_quartile(shape) > _MAX_SHAPE
    if not differs:
        return None
    largest = _upper_quartile(difference) * 1e3
    statement = (
        f"{name}.csv and {other}.csv are not of one plate and one set of numbers: at a quarter of "
        f"the places that both touched, their heights differ by {largest:.2f} mm or more"
    )
    rise = float(np.hypot(*slope) * np.ptp(places, axis=0).max() / 2)
    toward = float(np.degrees(np.arctan2(slope[1], slope[0]))) % 360
    higher, rise = (v if abs(v) > LEAST_MOVE else 0.0 for v in (float(height), rise))
    has_shape = _upper_quartile(shape) > _MAX_SHAPE
    if has_shape or not (higher or rise):
        remedy = (
            "Leave the older of the two out, or probe it again; of a plate that was turned say by "
            "how much (turned_deg, or --turned NAME=DEGREES on import)"
        )
        if has_shape and _is_bowl(places, shape):
            high = _bowl(places, shape)
            remedy = (
                f"The plate of {name}.csv is a {'bowl' if high.max() > 0 else 'dome'} of "
                f"{np.abs(high).max() * 1e3:.2f} mm against the other: of two plates, a hot and a "
                f"cold one, or two radii of the firmware leave out the one that is not in use; if "
                f"one list counts its heights downward, correct their sign"
            )
        return Note(f"{statement}. {remedy}", "apart")
    move = PlateMove(f"{name}.csv", higher, rise, toward, "that of the other")
    return Note(
        f"{statement}; {move.words}. An endstop, a screw of the plate or the probe was moved "
        f"between them, or a number was changed: set the endstops anew, by the calibration of the "
        f"firmware itself, and touch the plate again",
        "moved",
    )


def _differences(
    kinematics: DeltaKinematics, campaign: Readings, other: Readings, relative: bool,
    symmetry: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Return common places ``(n, 2)`` of two lists and by how much the plate of the first is
    higher there ``(n,)``, metres; empty if they are too few, or the plate was turned between them.

    With a symmetry, a matrix ``(3, 3)`` that takes points of the first to points of the other, each
    point is compared with its image.
    """
    from scipy.interpolate import LinearNDInterpolator  # which is slow to load

    few, many = sorted((campaign, other), key=lambda c: int(c.touching.sum()))
    if _turned(campaign) != _turned(other) or not few.touching.any():
        return np.empty((0, 2)), np.empty(0)
    (p, heights), (q, other_heights) = (_touched_heights(kinematics, c) for c in (few, many))
    if np.linalg.matrix_rank(plane_columns(q), tol=1e-3) < 3:
        return np.empty((0, 2)), np.empty(0)
    q, first = np.unique(np.round(q, 5), axis=0, return_index=True)
    to_other = np.eye(3) if symmetry is None else symmetry
    images = p @ (to_other if few is campaign else to_other.T)[:2, :2]
    heights = heights * to_other[2, 2]
    difference = heights - LinearNDInterpolator(q, other_heights[first])(images)
    difference *= 1 if few is campaign else -1
    common = np.isfinite(difference)
    if common.sum() < _MIN_COMMON_PLACES:
        return np.empty((0, 2)), np.empty(0)
    p, difference = p[common], difference[common]
    return p, difference - np.median(difference) * relative


def _trimmed_plane(places: Array, difference: Array) -> tuple[Array, float]:
    """Return the plane ``(3,)`` of differences of heights, and the largest tilt that is not
    significant, in metres.

    The plane is fitted to the three quarters of places with the smallest residuals. The limit is
    ``_MAX_TILT``, or three standard errors of the plane if that is larger. Their variance is that
    of all residuals and of three pseudo-residuals of the usual noise, for the three unknowns.
    """
    count = max(_MIN_COMMON_PLACES, int(np.ceil(0.75 * len(difference))))
    nearest = np.arange(len(difference))
    for _ in range(_TRIMMING_STEPS):
        plane, _ = fit_plane(places[nearest], difference[nearest])
        residual = difference - plane_columns(places) @ plane
        nearest = np.argsort(np.abs(residual), kind="stable")[:count]
    variance = (residual @ residual + 3 * _USUAL_NOISE**2) / len(residual)
    noise = _SIGNIFICANT_SIGMAS * float(np.sqrt(variance * 3 / len(residual)))
    return plane, max(_MAX_TILT, noise)


def _upper_quartile(difference: Array) -> float:
    """Return the size that a quarter of the differences of heights exceed, metres."""
    return float(np.quantile(np.abs(difference), 0.75)) if len(difference) else 0.0


def _touched_heights(kinematics: DeltaKinematics, campaign: Readings) -> tuple[Array, Array]:
    """Return places ``(n, 2)`` of touches and heights of the plate there ``(n,)``, metres."""
    rows = campaign.touching
    p = kinematics.places(campaign.command[rows])
    return p[:, :2], p[:, 2] - campaign.reading[rows]
