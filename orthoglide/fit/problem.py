"""What is asked of which readings: the unknowns, the campaigns, the noise and the tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import CATALOGUE, elementary, expand, family_of, is_dial
from orthoglide.errors import InputError
from orthoglide.fit.noise import Noise, station_table
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.observations import Campaign

# Beyond these a machine would not be an Orthoglide: they keep a solver from running away, and a
# parameter that ends on one is reported.
_BOUND_SD = 50.0
_LEAST_BOUND = {"mm": 0.05, "rad": 0.1}


@dataclass(frozen=True)
class Unknown:
    """One number to identify.

    Attributes:
        name: as reported; what is own to campaigns carries ``@`` and the stem of the first file.
        parts: for each campaign, the weights of the elementary parameters that it sets.
        tolerance: standard deviation to expect, SI.
        start: SI.
        bound: the value stays within plus and minus this, SI.
    """

    name: str
    parts: tuple[Mapping[str, float], ...]
    tolerance: float
    start: float
    bound: float


@dataclass(frozen=True)
class Problem:
    """An identification, ready to be solved by any of the methods.

    Attributes:
        machine: nominal dimensions, tolerances, and the parameters that are held.
        campaigns: the readings.
        unknowns: what is free, ``P`` of them.
        noise: of the readings.
        priors: whether tolerances act as priors about zero.
        held: for each campaign, parameters that are not free, SI.
        placement: standard deviation of a dial's place along its leg, metres; 0: exact.
        own: what has a value of its own in each campaign, free or not yet: families and
            parameters; with ``@`` and a file's stem, from that campaign on.
    """

    machine: Machine
    campaigns: tuple[Campaign, ...]
    unknowns: tuple[Unknown, ...]
    noise: Noise
    priors: bool
    held: tuple[Mapping[str, float], ...]
    placement: float
    own: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(u.name for u in self.unknowns)

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """Each campaign's place among the stacked readings."""
        ends = np.cumsum([len(c) for c in self.campaigns])
        return tuple(
            slice(int(e) - len(c), int(e)) for e, c in zip(ends, self.campaigns, strict=True)
        )

    @cached_property
    def measured(self) -> Array:
        """All readings ``(n,)``, metres."""
        return np.concatenate([c.reading for c in self.campaigns])

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of all readings ``(n,)``, metres."""
        return np.concatenate(self.noise.sigma)

    @cached_property
    def tolerance(self) -> Array:
        """Standard deviation to expect of the unknowns ``(P,)``, SI."""
        return np.array([u.tolerance for u in self.unknowns])

    @property
    def prior_sd(self) -> Array:
        """Prior standard deviations ``(P,)``, SI; infinite where tolerances do not act."""
        return self.tolerance if self.priors else np.full(len(self.unknowns), np.inf)

    @cached_property
    def start(self) -> Array:
        """Where to start ``(P,)``, SI."""
        return np.array([u.start for u in self.unknowns])

    @cached_property
    def bound(self) -> Array:
        """The unknowns stay within plus and minus this ``(P,)``, SI."""
        return np.array([u.bound for u in self.unknowns])

    def on_bound(self, x: Array) -> NDArray[np.bool_]:
        """Which of the unknowns ``x`` ``(P,)`` stand on their bounds."""
        return np.asarray(np.abs(x) >= self.bound * (1 - 1e-6))

    def elementary(self, campaign: int) -> tuple[tuple[str, ...], Array]:
        """Parameters that a campaign's unknowns set, and the matrix ``(E, P)`` from unknowns."""
        names = tuple(dict.fromkeys(n for u in self.unknowns for n in u.parts[campaign]))
        matrix = np.zeros((len(names), len(self.unknowns)))
        for k, unknown in enumerate(self.unknowns):
            for name, weight in unknown.parts[campaign].items():
                matrix[names.index(name), k] = weight
        return names, matrix

    def values(self, campaign: int, x: Array) -> dict[str, float]:
        """All parameters of a campaign's machine and dials at the unknowns ``x`` ``(P,)``, SI."""
        names, matrix = self.elementary(campaign)
        found = dict(self.held[campaign])
        for name, value in zip(names, matrix @ x, strict=True):
            found[name] = found.get(name, 0.0) + float(value)
        return found

    @cached_property
    def setup_of_row(self) -> NDArray[np.int64]:
        """Setup of each stacked reading, numbered over all campaigns ``(n,)``."""
        first = np.cumsum([0, *[len(c.setups) for c in self.campaigns]])
        return np.concatenate([c.setup + f for c, f in zip(self.campaigns, first, strict=False)])

    @cached_property
    def station(self) -> NDArray[np.int64]:
        """Station of each stacked reading ``(n,)``: visits that differ in nothing share one."""
        tables = [station_table(c) for c in self.campaigns]
        for table, rows in zip(tables, self.rows, strict=True):
            table[:, 0] = self.setup_of_row[rows]
        return np.unique(np.concatenate(tables), axis=0, return_inverse=True)[1].reshape(-1)

    @property
    def setup_count(self) -> int:
        """Setups of all campaigns together."""
        return sum(len(c.setups) for c in self.campaigns)

    @cached_property
    def representable(self) -> bool:
        """Whether the reduction's six parameters say all that is asked and held."""
        named = [n for i in range(len(self.campaigns)) for n in self.elementary(i)[0]]
        held = [n for values in self.held for n, v in values.items() if v]
        return all(family_of(n).name in ("joint_offset", "leg_length") for n in [*named, *held])

    def with_readings(self, readings: Array) -> Problem:
        """The same problem for other readings ``(n,)``, metres."""
        campaigns = tuple(
            c.with_readings(readings[rows])
            for c, rows in zip(self.campaigns, self.rows, strict=True)
        )
        return replace(self, campaigns=campaigns)


def build_unknowns(
    machine: Machine,
    campaigns: Sequence[Campaign],
    free: Sequence[str],
    own: Sequence[str] = (),
) -> tuple[Unknown, ...]:
    """Unknowns for families, parameters or structured members.

    Args:
        machine: tolerances, and where to start.
        campaigns: what is own to a campaign is repeated for each.
        free: what to identify.
        own: families or parameters that each campaign has for itself; ``axis_tilt.y.z@new`` has
            one value before the campaign ``new`` and another from it on.

    Raises:
        InputError: for names that are none, or campaigns of one name.
    """
    stems = [c.name for c in campaigns]
    if len(set(stems)) != len(stems):
        raise InputError(f"two campaigns are called alike ({', '.join(stems)}): rename one file")
    free_names = _expanded(free, campaigns)
    unknowns: list[Unknown] = []
    for name in free_names:
        starts = [k for k, stem in enumerate(stems) if k == 0 or _begins(name, stem, own)]
        for first, end in pairwise([*starts, len(stems)]):
            parts = tuple(
                _parts(name, c) if first <= k < end else {} for k, c in enumerate(campaigns)
            )
            if any(parts):
                shown = f"{name}@{stems[first]}" if len(starts) > 1 else name
                unknowns.append(_unknown(machine, shown, name, parts))
    return tuple(unknowns)


def _begins(name: str, stem: str, own: Sequence[str]) -> bool:
    """Whether a parameter has another value from a campaign on than before it."""
    wanted = [chosen.partition("@") for chosen in own]
    return is_dial(name) or any(_covers(n, name) and at in ("", stem) for n, _, at in wanted)


def _expanded(free: Sequence[str], campaigns: Sequence[Campaign]) -> tuple[str, ...]:
    setups = tuple(dict.fromkeys(s.name for c in campaigns for s in c.setups))
    found: dict[str, None] = {}
    for name in free:
        if name in CATALOGUE:
            found.update(dict.fromkeys(expand([name], setups)))
        else:
            elementary(name, setups)
            found[name] = None
    if not found:
        raise InputError("nothing is free: name at least one parameter or family to identify")
    return tuple(found)


def _covers(chosen: str, name: str) -> bool:
    return name == chosen or name.startswith(f"{chosen}.")


def _parts(name: str, campaign: Campaign) -> Mapping[str, float]:
    setups = tuple(s.name for s in campaign.setups)
    try:
        return elementary(name, setups)
    except InputError:
        if is_dial(name):  # another campaign's setup
            return {}
        raise


def _unknown(
    machine: Machine, name: str, plain: str, parts: tuple[Mapping[str, float], ...]
) -> Unknown:
    tolerance = machine.tolerance(plain)
    unit = family_of(plain).unit.name
    return Unknown(
        name,
        parts,
        tolerance,
        machine.values.get(plain, 0.0),
        max(_BOUND_SD * tolerance, _LEAST_BOUND.get(unit, 0.0)),
    )


def build_problem(
    machine: Machine,
    campaigns: Sequence[Campaign],
    free: Sequence[str],
    noise: Noise,
    *,
    own: Sequence[str] = (),
    priors: bool = True,
    bounds: Mapping[str, float] | None = None,
) -> Problem:
    """Put an identification together.

    Args:
        machine: dimensions, tolerances, parameters to hold or to start from.
        campaigns: at least one, with readings.
        free: families, parameters or structured members.
        noise: of the readings.
        own: what each campaign has for itself, see :func:`build_unknowns`; it need not be free.
        priors: whether tolerances act as priors.
        bounds: by unknown or family, SI; the value stays within plus and minus.

    Raises:
        InputError: where these do not fit together.
    """
    if not campaigns:
        raise InputError("there is no campaign: give at least one file of readings")
    _check_own(own, campaigns)
    unknowns = build_unknowns(machine, campaigns, free, own)
    if bounds:
        unknowns = tuple(replace(u, bound=_bound(u, bounds)) for u in unknowns)
    held = []
    for k in range(len(campaigns)):
        set_here = {n for u in unknowns for n in u.parts[k]}
        held.append({n: v for n, v in machine.values.items() if n not in set_here})
    return Problem(
        machine,
        tuple(campaigns),
        unknowns,
        noise,
        priors,
        tuple(held),
        machine.spec.dial.placement,
        tuple(own),
    )


def _check_own(own: Sequence[str], campaigns: Sequence[Campaign]) -> None:
    stems = [c.name for c in campaigns]
    for name in own:
        plain, at, stem = name.partition("@")
        if at and stem not in stems:
            raise InputError(f"{name}: there is no campaign {stem!r}, only {', '.join(stems)}")
        _expanded([plain], campaigns)


def _bound(unknown: Unknown, bounds: Mapping[str, float]) -> float:
    plain = unknown.name.split("@")[0]
    for key in (unknown.name, plain, family_of(plain).name):
        if key in bounds:
            if not bounds[key] > 0:
                raise InputError(f"the bound of {key} must be a positive number")
            return float(bounds[key])
    return unknown.bound
