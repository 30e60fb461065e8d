"""The candidates: every effect that these readings could show, alone, structured, as a family."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orthoglide.effects import BASE_FAMILIES, CATALOGUE, family_of, structured
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.observations import Campaign


@dataclass(frozen=True)
class Candidate:
    """A cause that may be added to the model.

    Attributes:
        name: ``axis_tilt.y.z``, ``axis_tilt.cyclic``, or a family such as ``screw_error.x``.
        family: of the catalogue.
        parameters: what is freed if it is added, as ``build_problem`` takes it.
        weights: of the elementary unknowns, one mapping for each of ``parameters``.
    """

    name: str
    family: str
    parameters: tuple[str, ...]
    weights: tuple[Mapping[str, float], ...]

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    def columns(self, names: tuple[str, ...]) -> Array:
        """Matrix ``(E, size)`` from the candidate's parameters to elementary unknowns."""
        place = {name: k for k, name in enumerate(names)}
        matrix = np.zeros((len(names), self.size))
        for k, weight in enumerate(self.weights):
            for name, value in weight.items():
                matrix[place[name], k] = value
        return matrix


def excited_families(problem: Problem) -> tuple[str, ...]:
    """Families beyond the base whose conditions the campaigns vary at all."""
    campaigns = problem.campaigns
    conditions = {
        "screw_error": problem.machine.spec.screw_pitch is not None,
        "backlash": _varies(campaigns, "approach"),
        "drive_compliance": any(c.load.any() for c in campaigns),
        "thermal_growth": _varies(campaigns, "temperature"),
        "thermal_drift": _varies(campaigns, "time") and not _varies(campaigns, "temperature"),
        "gauge_drift": _varies(campaigns, "time"),
    }
    return tuple(
        name for name in CATALOGUE if name not in BASE_FAMILIES and conditions.get(name, True)
    )


def _varies(campaigns: tuple[Campaign, ...], what: str) -> bool:
    for campaign in campaigns:
        values = getattr(campaign, what)
        known = values[np.isfinite(values).reshape(len(values), -1).all(axis=1)]
        if len(known) and np.ptp(known, axis=0).max() > 0:
            return True
    return False


def candidates(names: tuple[str, ...], families: tuple[str, ...]) -> tuple[Candidate, ...]:
    """All candidates made of elementary unknowns: single, structured, and families whole.

    Args:
        names: elementary unknowns at hand, campaign suffixes included.
        families: to be considered.
    """
    found: dict[str, Candidate] = {}
    for family in families:
        own = [n for n in names if family_of(n).name == family]
        members = _of_dials(family, own) if CATALOGUE[family].group == "dial" else _of(family, own)
        found.update({m.name: m for m in (*members, *_blocks(family, own))})
    return tuple(found.values())


def _of_dials(family: str, names: list[str]) -> list[Candidate]:
    """Candidates of dials: each campaign has its own."""
    members = [Candidate(n, family, (n,), ({n: 1.0},)) for n in names]
    for stem in dict.fromkeys(n.partition("@")[2] for n in names):
        suffix = f"@{stem}" if stem else ""
        here = tuple(n for n in names if n.partition("@")[2] == stem)
        members += _structured(family, here, suffix)
    return members


def _of(family: str, names: list[str]) -> list[Candidate]:
    """Candidates of the machine: what campaigns have for themselves makes one cause together."""
    parts: dict[str, list[str]] = {}
    for name in names:
        parts.setdefault(name.partition("@")[0], []).append(name)
    members = [
        Candidate(plain, family, tuple(full), tuple({n: 1.0} for n in full))
        for plain, full in parts.items()
    ]
    shared = tuple(plain for plain, full in parts.items() if full == [plain])
    separate = {tuple(n.partition("@")[2] for n in full) for full in parts.values()}
    if shared or len(separate) != 1:
        return members + _structured(family, shared, "")
    (stems,) = separate
    for pattern in _structured(family, tuple(parts), ""):
        (weights,) = pattern.weights
        copies = tuple({f"{n}@{stem}": w for n, w in weights.items()} for stem in stems)
        parameters = tuple(f"{pattern.name}@{stem}" for stem in stems)
        members.append(Candidate(pattern.name, family, parameters, copies))
    return members


def _structured(family: str, here: tuple[str, ...], suffix: str) -> list[Candidate]:
    plain = [n.partition("@")[0] for n in here]
    setups = tuple(n.partition(".")[2] for n in plain) if CATALOGUE[family].group == "dial" else ()
    members = []
    for name, weights in structured(family, setups).items():
        if set(weights) <= set(plain):
            full = {f"{n}{suffix}": w for n, w in weights.items()}
            members.append(Candidate(f"{name}{suffix}", family, (f"{name}{suffix}",), (full,)))
    return members


def _blocks(family: str, own: list[str]) -> list[Candidate]:
    """A family whole; and where a leg has two parameters of one cause, those of each leg."""
    if CATALOGUE[family].group == "dial" or len(own) < 2:
        return []
    blocks = {family: own}
    if family == "screw_error":
        blocks |= {
            f"{family}.{leg}": [n for n in own if n.split(".")[1] == leg]
            for leg in dict.fromkeys(n.split(".")[1] for n in own)
        }
    return [
        Candidate(name, family, tuple(members), tuple({m: 1.0} for m in members))
        for name, members in blocks.items()
    ]
