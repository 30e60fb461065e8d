"""What the truth table asks of the record of one campaign."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

from benchmarks.attribution_run import accepted
from benchmarks.runs import Record
from tests.rig import LEGS

T = TypeVar("T")

STRONG, APART = 3.0, 5.0
"""An effect should be named: rms past the base, and distance to the nearest other class."""

SEEN = 5.0
"""What lies outside the catalogue can be seen: told, it lowers chi2 by the square of this."""

UNNAMED = ("adequate", "diffuse")
"""Verdicts by which no part of the machine is wrong beyond its tolerance."""


def well(records: Iterable[Record]) -> list[Record]:
    """Records that ended."""
    return [r for r in records if r["word"] not in ("error", "crash")]


def singles(records: Iterable[Record]) -> list[Record]:
    """Campaigns with one effect of the catalogue."""
    return [r for r in well(records) if r["kind"] in ("effect", "structured") and r["truth"]]


def clear(truth: Record) -> bool:
    """Whether these readings should name a cause."""
    return bool(truth["rms"] >= STRONG and truth["distance"] >= APART)


def holds(effect: Record, truth: Record) -> bool:
    """Whether the cause named, or its class, is the true one."""
    return any(accepted(truth, name, parameters) for name, parameters, _ in effect["members"])


def named(record: Record) -> bool:
    """Whether any cause added is the true one."""
    return any(holds(e, record["truth"][0]) for e in record["effects"])


def alarmed(record: Record) -> bool:
    """Whether anything at all was said to be wrong."""
    return bool(record["word"] not in UNNAMED or record["blunders"])


def seen(record: Record) -> bool:
    """Whether these readings can see what lies outside the catalogue."""
    return bool(record["truth"][0]["norm"] >= SEEN)


def placed(record: Record) -> bool:
    """Whether the class of the true place was located."""
    return bool(classes(record))


def classes(record: Record) -> list[Sequence[str]]:
    """Classes that were located and hold the true place."""
    own = set(record["truth"][0]["places"])
    return [found["places"] for found in record["located"] if own & set(found["places"])]


def misplaced(record: Record) -> bool:
    """Whether a place or a name was claimed for what lies outside that is not its own."""
    elsewhere = len(classes(record)) < len(record["located"])
    others = [e for e in record["effects"] if not _is_shape_of_its_place(e, record)]
    return elsewhere or (record["word"] in ("explained", "ambiguous", "located") and bool(others))


def shaped(record: Record) -> bool:
    """Whether a known shape of the true place was named."""
    return any(_is_shape_of_its_place(e, record) for e in record["effects"])


def _is_shape_of_its_place(effect: Record, record: Record) -> bool:
    own = record["truth"][0]["places"]
    return any(is_shape_of(p, parts) for p in own for _, parts, _ in effect["members"])


def is_shape_of(place: str, parameters: Sequence[str]) -> bool:
    """Whether a cause is a known shape of a place: it moves the same joints by the same variable,
    as backlash does of a drive that goes wrong by the side it is approached from; a dial's scale is
    its curve as a straight line.
    """
    if place.startswith("dial."):
        return place == f"dial.{parameters[0].removeprefix('gauge_scale.')}/reading"
    return bool(parameters) and {_shape_place(n) for n in parameters} == {place}


_SHAPES = {
    "encoder_scale": "drive.{leg}/travel", "screw_error": "drive.{leg}/travel",
    "backlash": "drive.{leg}/approach", "axis_offset": "rail.{leg}.{end}/travel",
    "axis_tilt": "rail.{leg}.{end}/travel", "rail_bow": "rail.{leg}.{end}/travel",
    "mount_tilt": "carriage.{leg}.{axis}/travel", "thermal_drift": "bar.{leg}/time",
}  # fmt: skip
"""Places of which a parameter is a known shape: it moves the same joints by the same variable."""


def _shape_place(name: str) -> str:
    """Return the place of which a single parameter is a known shape; empty where there is none."""
    family, leg, end = (*name.split("."), "", "")[:3]
    if family not in _SHAPES or leg not in LEGS:
        return ""
    # A hinge turns about the leg's own axis a, or about the next one.
    axis = LEGS[(LEGS.index(leg) + (end == "b")) % 3]
    return _SHAPES[family].format(leg=leg, end=end, axis=axis)


def worse(record: Record) -> bool:
    """Whether the TCP is worse than before by more than was stated."""
    tcp = record["tcp"]
    return bool(tcp["after"][0] > tcp["before"][0] + tcp["stated"])


def wrongly_explained(record: Record) -> bool:
    """Whether a verdict claims to have explained what no effect of the catalogue is."""
    return record["word"] in ("explained", "ambiguous")


def upper_bound(hits: int, count: int) -> float:
    """Clopper and Pearson's one-sided upper 95 % bound of a share."""
    from scipy.special import betaincinv

    return 1.0 if hits >= count else float(betaincinv(hits + 1, count - hits, 0.95))


def share(records: Sequence[T], test: Callable[[T], Any]) -> str:
    """Percentage and counts."""
    hits = sum(bool(test(r)) for r in records)
    return f"{100 * hits / len(records):.1f} % ({hits}/{len(records)})" if records else "-"


def holds_alone(record: Record) -> bool:
    """Whether the cause named first is the true one itself."""
    effects = record["effects"][:1]
    return any(accepted(record["truth"][0], *e["members"][0][:2]) for e in effects)


def misnamed(record: Record) -> bool:
    """Whether causes were named and none of them is the true one."""
    return bool(record["effects"]) and not named(record)


def both_found(record: Record) -> bool:
    """Whether each of two causes is held by an effect of its own."""
    held = [{k for k, e in enumerate(record["effects"]) if holds(e, t)} for t in record["truth"]]
    return all(held) and len(set().union(*held)) > 1


def fault_found(record: Record) -> bool:
    """Whether a fault was reported with any of the rows that carry it."""
    touched = set(record["touched"])
    return any(touched & set(rows) for _, rows in record["blunders"])
