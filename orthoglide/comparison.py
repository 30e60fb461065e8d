"""The general mechanism against the reduction: what three drives and three bars cannot say.

For an effect, or a whole machine, the mechanism says where the TCP and the dials really are. The
reduction has six parameters, three joint offsets and three leg lengths, to come near: they are
fitted to the TCP over the workspace, and separately to the readings of a campaign. What is left is
what a user of the simplified model cannot get rid of. Everything here is nonlinear.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide import pss
from orthoglide.effects import CATALOGUE, MACHINE_PARAMETERS, family_of, is_dial
from orthoglide.errors import InputError, NumericsError
from orthoglide.geometry import LEGS, Array, Geometry
from orthoglide.machine import Machine, elementary
from orthoglide.observations import Campaign
from orthoglide.observations.protocols import Kind, protocol
from orthoglide.prediction import Conditions

TCP_LIMIT = 5e-6
"""Metres: the reduction is good enough where its fitted TCP is nowhere further off ..."""

READING_LIMIT = 5e-6
"""... and its fitted readings are no further off, rms: half the step of a workshop dial."""

_FIT_STEPS = 20


@dataclass(frozen=True)
class Circumstances:
    """What the machine goes through while it is compared.

    The workspace is visited twice: cold, at time zero, every axis arriving in the + direction;
    then warm, at the end, every axis arriving in the - direction. Six constants must do for both.

    Attributes:
        points: of the workspace along each axis.
        warming: kelvin from the first visit to the second, and over the campaign.
        duration: seconds from the first visit to the second; the campaign's is its protocol's.
        load: newtons at the TCP along base -z, always.
        pitch: of the screws, metres, where the machine file names none.
        kind: protocol of the campaign.
    """

    points: int = 7
    warming: float = 5.0
    duration: float = 3600.0
    load: float = 10.0
    pitch: float = 0.016
    kind: Kind = "sweep"


@dataclass(frozen=True)
class Difference:
    """Distance of two TCPs over the workspace, metres.

    Attributes:
        mean: over all points.
        max: the largest.
        where: TCP ``(3,)`` at which it is the largest.
    """

    mean: float
    max: float
    where: tuple[float, float, float]


@dataclass(frozen=True)
class Row:
    """How far the reduction is from the mechanism with one effect, or with all of a machine.

    Attributes:
        name: of the effect, or ``"machine"``.
        value: of its parameter, SI; nan for a machine.
        nominal: at the TCP, all six parameters of the reduction at zero: what the effect does.
        translated: the same after the best translation.
        fitted: with the six parameters fitted to the TCP.
        identified: with the six fitted to the readings, the machine's tolerances as priors, after
            the best translation, which leg readings cannot see.
        six: joint offsets and leg lengths fitted to the TCP, metres.
        rotation: largest turn of the platform, radians; the reduction's never turns.
        reading_change: what the effect does to the readings, datums fitted, rms, metres.
        reading_rms: readings with the six parameters and the datums fitted to them, metres.
        reading_max: the largest of these.
    """

    name: str
    value: float
    nominal: Difference
    translated: Difference
    fitted: Difference
    identified: Difference
    six: tuple[float, ...]
    rotation: float
    reading_change: float
    reading_rms: float
    reading_max: float

    @property
    def good_enough(self) -> bool:
        """Whether the reduction will do: ``TCP_LIMIT`` and ``READING_LIMIT`` hold after fits."""
        return self.fitted.max <= TCP_LIMIT and self.reading_rms <= READING_LIMIT

    @property
    def good_up_to(self) -> float:
        """Size of the parameter, SI, up to which the reduction will do, by proportion."""
        excess = max(self.fitted.max / TCP_LIMIT, self.reading_rms / READING_LIMIT)
        return float(abs(self.value) / excess) if excess > 1e-6 else float("inf")


def cube(geometry: Geometry) -> tuple[float, float]:
    """Ends, along every axis, of the largest cube of TCP points that the strokes reach, metres.

    By eq. (3) the carriage goes farthest out at ``p = (high, 0, 0)`` and farthest in at the corner
    ``low + sqrt(L^2 - 2 max(low^2, high^2)) = L + stroke_low``.
    """
    inner, high = geometry.L + geometry.stroke[0], geometry.stroke[1]
    low = (inner - np.sqrt(3 * geometry.L**2 - 2 * inner**2)) / 3
    if -low < high:
        low = inner - np.sqrt(geometry.L**2 - 2 * high**2)
    return float(low), float(high)


def compare_effects(
    machine: Machine | None = None,
    names: Iterable[str] | None = None,
    circumstances: Circumstances | None = None,
) -> tuple[Row, ...]:
    """Compare for effects one at a time, each at its tolerance on an else perfect machine.

    Args:
        machine: dimensions and tolerances; its identified parameters are left out.
        names: parameters, families or structured members; the whole catalogue where absent, dials
            by the campaign's first setup.
        circumstances: see there.

    Raises:
        InputError: for a name that is no effect.
    """
    bench = _Bench(machine or Machine.nominal(), circumstances or Circumstances())
    plain = bench.machine
    rows = []
    for name in _chosen(names, bench.campaign.setups[0].name):
        value = plain.tolerance(name)
        parts = elementary(name, tuple(s.name for s in bench.campaign.setups))
        rows.append(bench.row(name, value, {n: w * value for n, w in parts.items()}))
    return tuple(rows)


def compare_machine(
    machine: Machine, circumstances: Circumstances | None = None
) -> tuple[Row, ...]:
    """Compare for a calibrated machine: all of its parameters together, then each alone.

    Returns:
        Row ``"machine"`` first, then one for every parameter that is not zero.
    """
    bench = _Bench(machine, circumstances or Circumstances())
    values = {name: value for name, value in machine.values.items() if value}
    alone = (bench.row(name, value, {name: value}) for name, value in values.items())
    return (bench.row("machine", float("nan"), values), *alone)


def worst_of_families(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Of every family the row in which the reduction does worst, in the order of the rows."""
    found: dict[str, Row] = {}
    for row in rows:
        family = row.name.partition(".")[0]
        size = (round(row.fitted.max, 10), round(row.reading_rms, 10))
        best = found.get(family)
        if best is None or size > (round(best.fitted.max, 10), round(best.reading_rms, 10)):
            found[family] = row
    return tuple(found.values())


@dataclass(frozen=True)
class Slice:
    """Difference at the TCP after the fit, on one plane through mechanical zero.

    Attributes:
        normal: base axis across the plane, 0, 1 or 2.
        p: points ``(n, n, 3)``, metres, the other two axes in their order along rows and columns.
        difference: the larger of the two visits' ``(n, n)``, metres.
    """

    normal: int
    p: Array
    difference: Array


def slices(
    machine: Machine, points: int = 41, circumstances: Circumstances | None = None
) -> tuple[Slice, Slice, Slice]:
    """Difference of mechanism and fitted reduction on three planes of the cube.

    Args:
        machine: with its errors.
        points: along each side of a plane.
        circumstances: see there.
    """
    bench = _Bench(machine, circumstances or Circumstances())
    values = {name: value for name, value in machine.values.items() if not is_dial(name)}
    found, _ = bench.mechanism(values)
    six = _fit_tcp(bench.commands, found, bench.geometry)
    side = np.linspace(*cube(bench.geometry), points)
    planes = []
    for normal in range(3):
        p = np.insert(np.stack(np.meshgrid(side, side, indexing="ij"), -1), normal, 0.0, -1)
        rho = pss.inverse(p.reshape(-1, 3), geometry=bench.geometry)
        twice = bench.visits(rho)
        apart = bench.model.outputs(values, twice).p - _reduced(
            twice.command, six, bench.geometry
        )
        size = np.linalg.norm(apart, axis=1).reshape(2, points, points).max(axis=0)
        planes.append(Slice(normal, p, size))
    return planes[0], planes[1], planes[2]


def _chosen(names: Iterable[str] | None, setup: str) -> list[str]:
    if names is None:
        dials = [f"{n}.{setup}" for n, family in CATALOGUE.items() if family.group == "dial"]
        return [*MACHINE_PARAMETERS, *dials]
    found: dict[str, None] = {}
    for name in names:
        family = family_of(name)
        if name != family.name:
            many = [name]
        elif family.group == "dial":
            many = [f"{name}.{setup}"]
        else:
            many = list(family.parameters())
        found.update(dict.fromkeys(many))
    return list(found)


def _reduced(commands: Array, six: Array, geometry: Geometry) -> Array:
    return pss.forward(commands, six[:3], six[3:], geometry=geometry)


def _fit_tcp(commands: Array, p: Array, geometry: Geometry) -> Array:
    """Offsets and lengths ``(6,)`` with the least squares of TCP differences, Gauss-Newton."""
    six = np.zeros(6)
    for _ in range(_FIT_STEPS):
        found = _reduced(commands, six, geometry)
        slopes = pss.jacobians(found, commands, six[:3], six[3:], geometry=geometry)
        columns = np.concatenate(slopes, axis=-1).reshape(-1, 6)
        step = np.linalg.lstsq(columns, (p - found).reshape(-1), rcond=None)[0]
        six = six + step
        if np.abs(step).max() < 1e-12:
            return six
    raise NumericsError("the reduction's fit to the TCP does not converge: are the errors absurd?")


class _Bench:
    """A machine's workspace and campaign, set up once for many comparisons."""

    def __init__(self, machine: Machine, circumstances: Circumstances) -> None:
        pitch = machine.spec.screw_pitch or circumstances.pitch
        spec = replace(machine.spec, screw_pitch=pitch, parameters={})
        self.machine, self.circumstances = Machine(spec), circumstances
        self.geometry, self.model = spec.geometry, self.machine.model
        if circumstances.points < 2:
            raise InputError("the workspace needs at least two points along each axis")
        side = np.linspace(*cube(self.geometry), circumstances.points)
        grid = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
        self.seen = self.visits(pss.inverse(grid, geometry=self.geometry))
        self.commands = self.seen.command
        self.p = np.tile(grid, (2, 1))
        self.campaign = self._campaign()

    def visits(self, rho: Array) -> Conditions:
        """Conditions ``(2 n,)`` of the two visits to commands ``(n, 3)``."""
        n, way = len(rho), np.repeat([1.0, -1.0], len(rho))
        late = np.repeat([0.0, 1.0], n)
        c = self.circumstances
        return Conditions.at(
            np.tile(rho, (2, 1)),
            approach=np.tile(way[:, None], 3),
            time=late * c.duration,
            warming=late * c.warming,
            load=c.load,
        )

    def _campaign(self) -> Campaign:
        blank, c = protocol(self.circumstances.kind, self.geometry), self.circumstances
        return replace(
            blank,
            temperature=20.0 + c.warming * blank.time / blank.time.max(),
            load=np.full(len(blank), c.load),
        )

    def mechanism(self, values: dict[str, float]) -> tuple[Array, float]:
        """TCP ``(2 n, 3)`` over the workspace, and the largest turn of the platform."""
        out = self.model.outputs(values, self.seen)
        skew = out.R - np.swapaxes(out.R, 1, 2)
        sine = np.linalg.norm(skew[:, [2, 0, 1], [1, 2, 0]], axis=1) / 2
        return out.p, float(np.arcsin(np.clip(sine, 0, 1)).max())

    def difference(self, apart: Array) -> Difference:
        size = np.linalg.norm(apart, axis=1)
        at = self.p[int(np.argmax(size))]
        return Difference(
            float(size.mean()), float(size.max()), (float(at[0]), float(at[1]), float(at[2]))
        )

    def row(self, name: str, value: float, values: dict[str, float]) -> Row:
        machine = {n: v for n, v in values.items() if not is_dial(n)}
        found, rotation = self.mechanism(machine)
        six = _fit_tcp(self.commands, found, self.geometry)
        change, best, priors = self.readings(values)
        nominal, identified = found - self.p, found - self._tcp(priors.values)
        return Row(
            name,
            value,
            self.difference(nominal),
            self.difference(nominal - nominal.mean(axis=0)),
            self.difference(found - self._tcp(six)),
            self.difference(identified - identified.mean(axis=0)),
            tuple(six.tolist()),
            rotation,
            float(np.sqrt(np.mean(change**2))),
            float(np.sqrt(np.mean(best.residuals**2))),
            float(np.abs(best.residuals).max()),
        )

    def _tcp(self, six: Array) -> Array:
        return _reduced(self.commands, six, self.geometry)

    @cached_property
    def _nominal_readings(self) -> Array:
        return self.model.readings({}, self.campaign)

    def readings(self, values: dict[str, float]) -> tuple[Array, pss.ReadingFit, pss.ReadingFit]:
        """What the effect does to the readings less datums, and the reduction's two fits of them:
        the best there is, and the one an identification with priors finds."""
        c, tolerance = self.campaign, self.machine.spec.tolerance
        shown = self.model.readings(values, c)
        datums = np.eye(len(c.setups))[c.setup]
        change = shown - self._nominal_readings
        change = change - datums @ np.linalg.lstsq(datums, change, rcond=None)[0]
        own = np.repeat([tolerance["joint_offset"], tolerance["leg_length"]], len(LEGS))
        fits = [
            pss.fit_readings(
                c.command,
                c.leg,
                [c.setups[k].axis for k in c.setup],
                [c.setups[k].gauge for k in c.setup],
                shown,
                READING_LIMIT,
                signs=[float(c.setups[k].sign) for k in c.setup],
                prior_sd=prior,
                nuisance=datums,
                geometry=self.geometry,
            )
            for prior in (np.inf, own)
        ]
        return change, fits[0], fits[1]
