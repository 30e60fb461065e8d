"""What instruments on a linear delta can tell, computed from the tests' own delta alone.

As `benchmarks/independent.py` for the Orthoglide: columns are differences of `tests/rig_delta.py`
at a printer's tolerances about the machine without errors, whitened by each instrument's noise,
past its nuisances and past endstops, towers and arms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from benchmarks.delta_readings import NOISE, commands_of, exact, nuisances
from benchmarks.independent import (
    STEP,
    VISIBLE,
    Array,
    Candidate,
    Whitener,
    candidates_of,
    family_of,
)
from tests.rig_delta import LEGS, ON_PLATE, DeltaRig

TOLERANCE = {
    "joint_offset": 2e-3, "encoder_scale": 1e-3, "screw_error": 1e-5, "backlash": 5e-5,
    "drive_compliance": 1e-7, "axis_offset": 1e-3, "axis_tilt": 3e-3, "rail_tilt": 3e-3,
    "rail_bow": 1e-4, "mount_tilt": 1e-2, "leg_length": 5e-5, "bar_mismatch": 5e-5,
    "parallelogram_width": 3e-4, "thermal_growth": 5e-6, "thermal_drift": 1e-8,
    "rail_torsion": 2e-3, "plate_bow": 1e-4, "plate_saddle": 1e-4,
    "plate_trefoil": 1e-4, "plate_ring": 5e-5,
}  # fmt: skip
"""What to expect of a printer bolted together from extrusions, SI, in the catalogue's order."""

WIDER = tuple(
    f for f in TOLERANCE
    if f not in ("screw_error", "drive_compliance", "thermal_growth", "thermal_drift",
                 "rail_torsion", "plate_bow", "plate_saddle", "plate_trefoil", "plate_ring")
)  # fmt: skip
"""Of these, those for which a printer's differ from a workshop's."""

BASE = ("joint_offset", "axis_offset", "leg_length")
_ENDS = {
    "screw_error": ("sin", "cos"), "mount_tilt": ("a", "b"),
    **dict.fromkeys(("axis_offset", "axis_tilt", "rail_tilt", "rail_bow"),
                    ("radial", "tangential")),
}  # fmt: skip
_STILL = ("screw_error", "backlash", "drive_compliance", "thermal_growth", "thermal_drift")
"""Effects that readings without a screw, a load or a temperature, all from above, cannot show."""


def parameters(family: str) -> list[str]:
    """Return the single parameters of a family of the machine."""
    ends = [f".{end}" for end in _ENDS.get(family, ())] or [""]
    return [f"{family}.{leg}{end}" for leg in LEGS for end in ends]


def machine_parameters() -> Iterator[str]:
    """Yield the parameters of the machine itself, in the catalogue's order."""
    for family in TOLERANCE:
        if not family.startswith("plate"):
            yield from parameters(family)


def weights_of(name: str) -> dict[str, float]:
    """Return the single parameters of a name, a structured member or a parameter, with weights."""
    family, _, rest = name.partition(".")
    if rest.endswith("common"):
        end = rest.removesuffix("common").rstrip(".")
        return {n: 1.0 for n in parameters(family) if n.endswith(f".{end}" if end else "")}
    return {name: 1.0}


def structured(family: str) -> dict[str, dict[str, float]]:
    """Return the structured members of a family: the same of all legs, direction by direction."""
    ends = _ENDS.get(family, ("",))
    names = [f"{family}.{end}.common" if end else f"{family}.common" for end in ends]
    return {name: weights_of(name) for name in names}


@cache
def _poses(kind: str, name: str) -> list[list[tuple[Array, Array]]]:
    """Return tool and rotation vector at an instrument's places, of the machine without errors or
    with a hundredth of one parameter's tolerance.
    """
    commands = commands_of(kind, DeltaRig())
    return [[_pose(name, tuple(np.round(s, 12).tolist())) for s in each] for each in commands]


@cache
def _pose(name: str, command: tuple[float, ...]) -> tuple[Array, Array]:
    rig = DeltaRig(errors={name: STEP * TOLERANCE[family_of(name)]} if name else {})
    return rig.pose(np.array(command), np.zeros(3))


def _column(kind: str, name: str) -> Array:
    """Return what a parameter at its tolerance adds to an instrument's readings ``(n,)``."""
    size = STEP * TOLERANCE[family_of(name)]
    rig = DeltaRig(errors={name: size})
    moved = _poses(kind, "" if name.startswith("plate") else name)
    return (exact(kind, rig, moved) - exact(kind, DeltaRig(), _poses(kind, ""))) / STEP


@dataclass(frozen=True, eq=False)
class DeltaVisible:
    """What causes show in the readings of some instruments.

    Attributes:
        whitener: past nuisances and base.
        beside: the same past the background of all else.
        columns: of visible parameters at their tolerance, in readings.
        count: number of readings.
    """

    whitener: Whitener
    beside: Whitener
    columns: dict[str, Array]
    count: int

    def candidates(self, beside: bool) -> dict[str, Candidate]:
        """Return all candidates, whitened, past the background or not."""
        past = (self.beside if beside else self.whitener).past
        white = {n: past(c) for n, c in self.columns.items()}
        families = dict.fromkeys(map(family_of, white))
        members = {f: structured(f) for f in families if not f.startswith("plate")}
        return candidates_of(white, members, "screw_error")


@cache
def visible(kinds: tuple[str, ...], background: float) -> DeltaVisible:
    """Return what causes show in these instruments' readings.

    Args:
        kinds: of instruments.
        background: share of their tolerances by which all effects are off.
    """
    values = [exact(kind, DeltaRig(), _poses(kind, "")) for kind in kinds]
    sigma = np.concatenate([
        np.full(len(v), NOISE["plate" if k == "seven" else k])
        for k, v in zip(kinds, values, strict=True)
    ])  # fmt: skip
    free, known = (
        _blocks([nuisances(k, v)[which] for k, v in zip(kinds, values, strict=True)])
        for which in (0, 1)
    )
    plates = [shape.format("bed") for shape in ON_PLATE]
    names = [n for n in machine_parameters() if family_of(n) not in _STILL] + plates
    columns = {n: np.concatenate([_column(kind, n) for kind in kinds]) for n in names}
    base = np.stack([columns[n] for n in names if family_of(n) in BASE], axis=1)
    others = {n: c for n, c in columns.items() if family_of(n) not in BASE}
    # A machine's background is none of its plate's.
    quiet = [background * c for n, c in others.items() if not n.startswith("plate")]
    whitener = Whitener(sigma, free, np.hstack([known, base]))
    beside = Whitener(sigma, free, np.hstack([known, base, np.stack(quiet, axis=1)]))
    seen = {n: c for n, c in others.items() if np.linalg.norm(whitener.past(c)) > VISIBLE}
    return DeltaVisible(whitener, beside, seen, len(sigma))


def _blocks(parts: list[Array]) -> Array:
    """Return a block-diagonal matrix."""
    rows, columns = (sum(p.shape[k] for p in parts) for k in (0, 1))
    found, at, to = np.zeros((rows, columns)), 0, 0
    for part in parts:
        found[at : at + len(part), to : to + part.shape[1]] = part
        at, to = at + len(part), to + part.shape[1]
    return found
