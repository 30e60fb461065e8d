"""A machine's workspace and campaign, and the reduction fitted to both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide import reduction
from orthoglide.comparison.rows import ALIKE, READING_LIMIT, Difference, Row
from orthoglide.effects import family_of, is_dial
from orthoglide.errors import InputError, NumericsError
from orthoglide.geometry import LEGS, Array, Geometry
from orthoglide.machine import Machine
from orthoglide.observations import Campaign
from orthoglide.observations.protocols import Kind, protocol
from orthoglide.prediction import Conditions

_FIT_STEPS = 20


@dataclass(frozen=True)
class Circumstances:
    """What the machine goes through while it is compared.

    The workspace is visited twice: cold, at time zero, every axis arriving in the + direction;
    then warm, at the end, every axis arriving in the - direction. Six constants must do for both.
    Where the machine file gives a stiffness, the load deforms the machine too.

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


def reduced(commands: Array, six: Array, geometry: Geometry) -> Array:
    """TCP ``(n, 3)`` of the reduction with offsets and lengths ``six`` ``(6,)``, metres."""
    return reduction.forward(commands, six[:3], six[3:], geometry=geometry)


def fit_tcp(commands: Array, p: Array, geometry: Geometry) -> Array:
    """Offsets and lengths ``(6,)`` with the least squares of TCP differences, Gauss-Newton."""
    six = np.zeros(6)
    for _ in range(_FIT_STEPS):
        found = reduced(commands, six, geometry)
        slopes = reduction.jacobians(found, commands, six[:3], six[3:], geometry=geometry)
        columns = np.concatenate(slopes, axis=-1).reshape(-1, 6)
        step = np.linalg.lstsq(columns, (p - found).reshape(-1), rcond=None)[0]
        six = six + step
        if np.abs(step).max() < 1e-12:
            return six
    raise NumericsError("the reduction's fit to the TCP does not converge: are the errors absurd?")


class Bench:
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
        self.seen = self.visits(reduction.inverse(grid, geometry=self.geometry))
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

    def _gives_way(self, values: dict[str, float]) -> bool:
        """Whether the load does anything: forces cost a closure of their own."""
        soft = any(family_of(name).group == "load" for name in values)
        return soft or self.machine.spec.stiffness.bar is not None

    def mechanism(self, values: dict[str, float]) -> tuple[Array, float]:
        """TCP ``(2 n, 3)`` over the workspace, and the largest turn of the platform."""
        gives = self._gives_way(values)
        seen = self.seen if gives else replace(self.seen, load=np.zeros(len(self.seen)))
        half = len(seen) // 2
        moves = self.model.displacements(values, seen)
        if np.array_equal(moves[:half], moves[half:]):  # both visits are alike: one will do
            out = self.model.outputs(values, seen.part(slice(half)))
            p = np.tile(out.p, (2, 1))
        else:
            out = self.model.outputs(values, seen)
            p = out.p
        skew = out.R - np.swapaxes(out.R, 1, 2)
        sine = np.linalg.norm(skew[:, [2, 0, 1], [1, 2, 0]], axis=1) / 2
        return p, float(np.arcsin(np.clip(sine, 0, 1)).max())

    def difference(self, apart: Array) -> Difference:
        """Differences ``(2 n, 3)`` over the workspace in three numbers."""
        size = np.linalg.norm(apart, axis=1)
        at = self.p[int(np.argmax(size >= size.max() - ALIKE))]  # the first of those alike
        return Difference(
            float(size.mean()), float(size.max()), (float(at[0]), float(at[1]), float(at[2]))
        )

    def row(self, name: str, value: float, values: dict[str, float]) -> Row:
        """Compare for parameters ``values``; name and value are for the table."""
        machine = {n: v for n, v in values.items() if not is_dial(n)}
        found, rotation = self.mechanism(machine)
        six = fit_tcp(self.commands, found, self.geometry)
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
        return reduced(self.commands, six, self.geometry)

    @cached_property
    def _nominal_readings(self) -> Array:
        return self.model.readings({}, self.campaign)

    def readings(
        self, values: dict[str, float]
    ) -> tuple[Array, reduction.ReadingFit, reduction.ReadingFit]:
        """What the effect does to the readings less datums, and the reduction's two fits of them:
        the best there is, and the one an identification with priors finds.
        """
        c, tolerance = self.campaign, self.machine.spec.tolerance
        if not self._gives_way(values):
            c = replace(c, load=np.zeros(len(c)))
        shown = self.model.readings(values, c)
        datums = np.eye(len(c.setups))[c.setup]
        change = shown - self._nominal_readings
        change = change - datums @ np.linalg.lstsq(datums, change, rcond=None)[0]
        own = np.repeat([tolerance["joint_offset"], tolerance["leg_length"]], len(LEGS))
        fits = [
            reduction.fit_readings(
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
