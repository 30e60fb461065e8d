"""A design before any measurement: the readings to take, what they see, and how often."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from orthoglide.accuracy import tcp_slopes, without_translation, workspace_grid
from orthoglide.arguments import public
from orthoglide.errors import InputError, check_list
from orthoglide.geometry import Array
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings
from orthoglide.planning.linear import (
    CombinationPrecision,
    LinearReadings,
    choose,
    elementary_weights,
)
from orthoglide.planning.sheets import reading_pool, sheet_from_pool
from orthoglide.prediction import Conditions
from orthoglide.report.terminal import console_text, table
from orthoglide.simulation import varied_conditions
from orthoglide.threads import on_one_thread
from orthoglide.units import MM, Unit

if TYPE_CHECKING:
    import pandas as pd

TCP = "TCP"
"""Stands for the TCP where a parameter's name might stand."""

_LOOSE_TOLERANCES = 100.0  # tolerances: priors that only keep a determinant finite
_MIN_SINGULAR_RATIO = 1e-9  # of the largest singular value: rounding
_MAX_REPEATS = 1000  # repeats: nobody visits a station more often
_COMMANDS_PER_AXIS = 4  # commands along each axis: enough for a mean over the workspace
_MIN_SIGMA_SHARE = 1e-3  # of a reading's sigma: keeps the limit of many repeats finite


@dataclass(frozen=True)
class Observability:
    """How well the readings of a campaign see some unknowns.

    With the singular values ``s_1 >= ... >= s_m`` of the identification Jacobian of ``n`` readings
    (Y. Sun and J. M. Hollerbach, "Observability index selection for robot calibration", ICRA 2008):

        O1 = (s_1 ... s_m)^(1/m) / sqrt(n)      O2 = s_m / s_1      O3 = s_m
        O4 = s_m^2 / s_1                        O5 = 1 / (1/s_1 + ... + 1/s_m)

    O1 is D-, O3 E- and O5 close to A-optimality. Unknowns are in tolerances and readings in sigmas,
    datums and the dials' places taken out, so that the figures compare between campaigns.
    """

    readings: int  # how many
    singular: tuple[float, ...]  # (m,), largest first, sigmas a tolerance; 0 where not determined

    @classmethod
    def of_jacobian(cls, jacobian: Array, readings: int) -> Observability:
        """Return the observability by a whitened Jacobian ``(rows, m)`` of so many readings."""
        singular = np.zeros(jacobian.shape[1])
        values = np.linalg.svd(jacobian, compute_uv=False)
        singular[: len(values)] = values
        singular[singular < _MIN_SINGULAR_RATIO * singular.max(initial=0.0)] = 0.0
        return cls(readings, tuple(singular.tolist()))

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return len(self.singular)

    @property
    def rank(self) -> int:
        """Number of combinations of the unknowns that the readings determine."""
        return int(np.count_nonzero(self.singular))

    @property
    def indices(self) -> dict[str, float]:
        """The five indices by name; 0 if a combination of the unknowns is not determined."""
        s = np.array(self.singular)
        if self.rank < self.unknowns:
            return dict.fromkeys(_INDEX_WORDS, 0.0)
        o1 = np.exp(np.mean(np.log(s))) / np.sqrt(self.readings)
        values = (o1, s[-1] / s[0], s[-1], s[-1] ** 2 / s[0], 1 / np.sum(1 / s))
        return dict(zip(_INDEX_WORDS, map(float, values), strict=True))


def observability(
    machine: Machine, campaign: Readings, free: Sequence[str], noise: float | None = None
) -> Observability:
    """Return the observability indices of a campaign or protocol, with or without readings.

    ``free`` are effects, parameters or structured members to identify; ``noise`` is the standard
    deviation of one reading, metres, as the machine's dial has it if absent.
    """
    names = machine.catalogue.expand(free, [s.name for s in campaign.setups])
    readings = LinearReadings.of(machine, campaign, names, noise)
    return Observability.of_jacobian(readings.whitened(), len(campaign))


_INDEX_WORDS = {
    "O1": "all unknowns", "O2": "evenness", "O3": "worst seen", "O4": "O2 times O3",
    "O5": "mean seen",
}  # fmt: skip


def index_table(compared: Sequence[tuple[str, Observability]]) -> str:
    """Return a table of observability indices, a column a campaign or protocol."""
    names, columns = zip(*compared, strict=True)
    rows = [
        ("readings", *(str(column.readings) for column in columns)),
        ("unknowns seen", *(f"{column.rank} of {column.unknowns}" for column in columns)),
    ]
    for index, words in _INDEX_WORDS.items():
        values = (f"{column.indices[index]:.2g}" for column in columns)
        rows.append((f"{index}, {words}", *values))
    return console_text(table(("the larger the better", *names), rows))


# -- readings to take ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Design:
    """Readings chosen before any is taken.

    Attributes:
        names: parameters it is for.
        campaign: a measuring sheet.
        value: log det of the information in tolerances, gained over its loose priors.
        indices: of the sheet for ``names``.
    """

    names: tuple[str, ...]
    campaign: Readings
    value: float
    indices: Observability

    def __repr__(self) -> str:
        return f"<Design: {len(self.campaign)} readings for {len(self.names)} parameters>"

    def to_frame(self) -> pd.DataFrame:
        """Return the measuring sheet as a data frame, a row a reading.

        Raises:
            InputError: where pandas is not installed.
        """
        return self.campaign.to_frame()

    def _repr_html_(self) -> str:
        return self.campaign._repr_html_()


@public
@on_one_thread
def design(
    machine: MachineSource,
    free: Sequence[str] | None = None,
    count: int = 24,
    *,
    noise: float | None = None,
) -> Design:
    """Choose readings before any is taken, one after the other: those that raise the determinant of
    the information most.

    Args:
        machine: tolerances, dial, and where to linearise.
        free: effects, parameters or structured members to identify; zeros and lengths if None, all
            that readings of the pool can show if empty.
        count: readings.
        noise: standard deviation of one reading, metres.

    Raises:
        InputError: for effects of a dial, which belong to a mounting, for those that no reading of
            the pool can show, or too few readings.
    """
    check_list("free", () if free is None else free)
    machine = Machine.of(machine)
    pool, catalogue = reading_pool(machine.geometry), machine.catalogue
    conditions = varied_conditions(machine, pool) - {"time", "temperature"}  # no design plans them
    shown = [n for n, e in catalogue.items() if not e.of_dial and e.needs <= conditions]
    free = catalogue.base if free is None else free or shown
    for name in free:
        effect = catalogue.effect_of(name)
        if effect.of_dial or not effect.needs <= conditions:
            reason = (
                "belongs to one mounting of a dial"
                if effect.of_dial
                else "shows in no reading that a design can choose (no load, warmth, drift or "
                "screw pitch is known)"
            )
            raise InputError(f"{name} {reason}: leave it out")
    names = catalogue.expand(free)
    readings = LinearReadings.of(machine, pool, names, noise)
    start = CombinationPrecision(np.eye(len(names)) / _LOOSE_TOLERANCES**2, np.eye(len(names)))
    rows, best = choose(readings, start, count)
    if not rows:
        raise InputError("through this noise no reading says anything: correct it")
    campaign = sheet_from_pool(pool, rows, "design")
    indices = observability(machine, campaign, names, noise)
    return Design(names, campaign, best.value - start.value, indices)


# -- how often to take them ------------------------------------------------------------------------


@dataclass(frozen=True)
class Repeats:
    """How often every station must be visited for a wanted accuracy."""

    what: str  # parameter, or `"TCP"`: rms over workspace and axes after the best translation
    wanted: float  # standard deviation, SI
    repeats: int | None  # visits to every station; `None` where no number is enough
    sigma: float  # with that many; with one visit where none is enough
    floor: float  # with any number of repeats: rounding, placement, undetermined combinations
    unit: Unit = MM  # of the standard deviations in files

    def __str__(self) -> str:
        wanted, sigma, floor = (v / self.unit.si for v in (self.wanted, self.sigma, self.floor))
        request = f"sigma {wanted:.3g}{self.unit.behind} of {self.what} (tolerances as priors)"
        if self.repeats is None and self.floor < self.wanted:
            return (
                f"{request} takes more than {_MAX_REPEATS} visits to every station: {sigma:.3g} "
                f"with one visit, {floor:.3g} with any number"
            )
        if self.repeats is None:
            return (
                f"{request} is out of reach of repeats: {sigma:.3g} with one visit, "
                f"{floor:.3g} with any number"
            )
        visits = "visit" if self.repeats == 1 else "visits"
        return f"{request} takes {self.repeats} {visits} to every station, which gives {sigma:.3g}"


@public
def repeats_needed(
    machine: MachineSource,
    campaign: Readings,
    free: Sequence[str],
    what: str,
    wanted: float,
    noise: float | None = None,
) -> Repeats:
    """Return how often every station must be visited for a wanted accuracy.

    Repeats reduce the scatter of readings. They reduce neither the rounding that a station's
    visits share, nor the dial's misplacement, nor what no reading of the protocol sees.

    Args:
        machine: tolerances and dial.
        campaign: stations; its own repeats do not count.
        free: to identify, with their tolerances as priors.
        what: one of their parameters, or ``"TCP"``.
        wanted: standard deviation, SI.
        noise: standard deviation of one reading, metres.

    Raises:
        InputError: for a parameter that is not identified, or a ``wanted`` that is not positive.
    """
    if not wanted > 0:
        raise InputError(f"the accuracy wanted of {what} must be a positive standard deviation")
    machine = Machine.of(machine)
    _, first_visits = np.unique(campaign.stations, axis=0, return_index=True)
    single_visits = campaign.subset(np.sort(first_visits))
    names = machine.catalogue.expand(free, [s.name for s in single_visits.setups])
    if what != TCP and what not in names:
        choices = ", ".join(names)
        raise InputError(f"{what} is not identified here: it is TCP, or one of {choices}")
    slope = _target_slopes(machine, names, what)
    unit = MM if what == TCP else machine.catalogue.effect_of(what).unit
    readings = LinearReadings.of(machine, single_visits, names, noise)

    def sigma(repeats: float) -> float:
        mean = readings.sigma * max(1 / np.sqrt(repeats), _MIN_SIGMA_SHARE)
        information = replace(readings, sigma=mean).information()
        spread = slope @ np.linalg.inv(information + np.eye(len(names)))
        return float(np.sqrt(np.mean(np.sum(spread * slope, axis=1))))

    visits, counts = None, range(1, _MAX_REPEATS + 1)
    if sigma(_MAX_REPEATS) <= wanted:
        visits = counts[bisect_left(counts, True, key=lambda n: sigma(n) <= wanted)]
    return Repeats(what, wanted, visits, sigma(visits or 1), sigma(np.inf), unit)


def _target_slopes(machine: Machine, names: Sequence[str], what: str) -> Array:
    """Return the derivatives ``(n, P)`` of a figure by names in tolerances: of one parameter, or
    of the TCP's coordinates over the workspace, their mean removed.
    """
    if what != TCP:
        return np.array([[machine.tolerance(n) if n == what else 0.0 for n in names]])
    machine_names = [n for n in names if not machine.catalogue.effect_of(n).of_dial]
    parts, weights = elementary_weights(machine, machine_names)
    conditions = Conditions.from_commands(
        workspace_grid(machine.geometry, _COMMANDS_PER_AXIS, machine.spec.screw_pitch)
    )
    slope = np.zeros((3 * len(conditions), len(names)))
    tcp_slope = without_translation(tcp_slopes(machine, parts, conditions) @ weights)
    slope[:, [names.index(n) for n in machine_names]] = tcp_slope.reshape(len(slope), -1)
    return slope


# -- waves between the stations --------------------------------------------------------------------

_SHORTEST_WAVE = 5e-3
"""Metres: the smallest common lead of a ball screw, where the machine file states none."""

_CURVE_DEGREE = 2  # degree of the polynomial that a wave looks like: a bow
_MIN_STATIONS = _CURVE_DEGREE + 3  # stations: fewer show no curve that could be compensated
_MIN_VISIBLE_SHARE = 0.05  # of a wave's size: 5 um of a wave of 0.1 mm are the noise of a dial
_ROUNDING = 1e-6  # of a period: stations are rounded to a micrometre
_PERIODS_PER_CYCLE = 10  # periods that are tried while the stroke takes one more cycle


def aliasing(machine: MachineSource, sheet: Readings) -> tuple[str, ...]:
    """Return a warning for each drive on which a sheet of dials on legs cannot tell a short wave
    from a curve.

    Waves are tried from the lead of the screws (5 mm where the machine file states none) to twice
    the largest distance of neighbouring stations; longer ones are sampled twice a cycle.
    """
    machine, warnings = Machine.of(machine), list[str]()
    shortest = machine.spec.screw_pitch or _SHORTEST_WAVE
    for leg, name in enumerate(machine.geometry.leg_names):
        positions = np.unique(np.round(sheet.command[sheet.on_legs & (sheet.leg == leg), leg], 6))
        if len(positions) < _MIN_STATIONS:
            continue
        span, longest = float(np.ptp(positions)), 2 * float(np.diff(positions).max())
        if longest <= shortest * (1 + _ROUNDING):
            continue
        # The visible share of a wave is what no parabola fits, at the least visible phase.
        cycles = np.arange(span / longest, span / shortest, 1 / _PERIODS_PER_CYCLE)
        u = (positions - positions.min()) / span
        curves, _ = np.linalg.qr(np.polynomial.legendre.legvander(2 * u - 1, _CURVE_DEGREE))
        phase = 2 * np.pi * cycles[:, None] * u
        waves = np.stack([np.sin(phase), np.cos(phase)], axis=2)
        visible = np.linalg.svd(waves - curves @ (curves.T @ waves), compute_uv=False)[:, -1]
        worst = int(np.argmin(visible))
        # A sine over many stations has the norm sqrt(n / 2).
        if visible[worst] / np.sqrt(len(positions) / 2) < _MIN_VISIBLE_SHARE:
            period = float(span / cycles[worst])
            warnings.append(
                f"at the {len(positions)} stations of drive {name} a wave of {period * 1e3:.3g} mm "
                f"looks like a smooth curve, so that a compensation from this sheet may make the "
                f"tool worse between the stations: choose other, unequal distances, or "
                f"stations less than {shortest * 1e3 / 2:.2g} mm apart"
            )
    return tuple(warnings)
