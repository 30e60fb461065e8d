"""Effects, machines and planes of the workspace: the mechanism, and the reduction fitted to it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide import reduction
from orthoglide.comparison.rows import EQUAL_WITHIN, READING_LIMIT, Difference, Row
from orthoglide.errors import InputError, NumericsError
from orthoglide.geometry import LEGS, Array, Geometry, axial_vectors
from orthoglide.machine import Machine, MachineSource
from orthoglide.mechanism.perfect_legs import Spheres, commands
from orthoglide.observations import Readings
from orthoglide.observations.protocols import ProtocolName, protocol
from orthoglide.prediction import Conditions
from orthoglide.reduction.spheres import Mode, intersect_spheres
from orthoglide.units import ONE

_FIT_STEPS = 20
_NAN = float("nan")
_NO_DIFFERENCE = Difference(_NAN, _NAN, (_NAN,) * 3)


@dataclass(frozen=True)
class Circumstances:
    """What the machine goes through while it is compared.

    The workspace is visited twice: cold, at time zero, every axis arriving in the + direction;
    then warm, at the end, every axis arriving in the - direction. Six constants must do for both.
    Where the machine file gives a stiffness, the load deforms the machine too.
    """

    points: int = 7  # of the workspace along each axis
    warming: float = 5.0  # kelvin from the first visit to the second, and over the campaign
    duration: float = 3600.0  # seconds from the first visit to the second
    load: float = 10.0  # newtons at the TCP along base -z, always
    pitch: float = 0.016  # of the screws, metres, where the machine file names none
    kind: ProtocolName = "sweep"  # protocol of the campaign

    def visit_conditions(self, rho: Array) -> Conditions:
        """Return the conditions ``(2 n,)`` of the two visits to commands ``(n, 3)``."""
        late = np.repeat([0.0, 1.0], len(rho))
        return Conditions.from_commands(
            np.tile(rho, (2, 1)),
            approach=np.tile(1.0 - 2.0 * late[:, None], 3),
            time=late * self.duration,
            warming=late * self.warming,
            load=self.load,
        )

    def campaign(self, geometry: Geometry) -> Readings:
        """A sheet of the protocol that warms up evenly, under the load."""
        blank = protocol(self.kind, geometry)
        warmth = 20.0 + self.warming * blank.time / blank.time.max()
        return replace(blank, temperature=warmth, load=np.full(len(blank), self.load))


def cube(geometry: Geometry) -> tuple[float, float]:
    """Return the ends, along every axis, of the largest cube of TCP points that the strokes reach,
    metres.

    By eq. (3) the carriage goes farthest out at ``p = (high, 0, 0)`` and farthest in at the corner
    ``low + sqrt(L^2 - 2 max(low^2, high^2)) = L + stroke_low``.
    """
    inner, high = geometry.L + geometry.stroke[0], geometry.stroke[1]
    low = (inner - np.sqrt(3 * geometry.L**2 - 2 * inner**2)) / 3
    if -low < high:
        low = inner - np.sqrt(geometry.L**2 - 2 * high**2)
    return float(low), float(high)


def grid(geometry: Geometry, count: int) -> Array:
    """Return TCP points ``(n, 3)`` that fill the workspace evenly, metres.

    On the Orthoglide they fill the cube with ``count`` points along each axis; other layouts have
    points of their own.
    """
    points = geometry.layout.points(geometry.L, geometry.r, geometry.stroke, count)
    if points is not None:
        return points
    side = np.linspace(*cube(geometry), count)
    return np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)


class Comparison:
    """The workspace of a machine, and a campaign of dials where they stand on legs."""

    def __init__(
        self, machine: MachineSource | None = None, circumstances: Circumstances | None = None
    ) -> None:
        self.circumstances = circumstances or Circumstances()
        if self.circumstances.points < 2:
            raise InputError("the workspace needs at least two points along each axis")
        plain = Machine.of(machine).with_only({})
        pitch = plain.spec.screw_pitch or self.circumstances.pitch
        self.machine = replace(plain, spec=replace(plain.spec, screw_pitch=pitch))
        self.geometry, self.model = plain.geometry, self.machine.model
        points = grid(self.geometry, self.circumstances.points)
        self.p = np.tile(points, (2, 1))
        self.conditions = self.circumstances.visit_conditions(
            commands(Spheres.of_geometry(self.geometry), points)
        )
        zero = intersect_spheres(self.geometry.centres, self.geometry.L)
        self.mode: Mode = "machine" if np.abs(zero).max() < EQUAL_WITHIN else "other"

    @cached_property
    def campaign(self) -> Readings:
        """Of dials on legs: the Orthoglide's alone."""
        return self.circumstances.campaign(self.geometry)

    @cached_property
    def perfect_readings(self) -> Array:
        """Readings of the campaign on the perfect machine ``(n,)``, metres."""
        return self.model.readings({}, self.campaign)

    def mechanism_tcp(
        self, values: Mapping[str, float], conditions: Conditions | None = None
    ) -> tuple[Array, float]:
        """Return the TCP ``(n, 3)`` of the mechanism, and the platform's largest turn, radians."""
        conditions = conditions or self.conditions
        distinct, rows = conditions.merged(self.model.needed_conditions(values))
        outputs = self.model.outputs(values, distinct)
        sines = np.linalg.norm(axial_vectors(outputs.R), axis=1)
        return outputs.p[rows], float(np.arcsin(np.clip(sines, 0, 1)).max())

    def reduction_tcp(self, six: Array, conditions: Conditions | None = None) -> Array:
        """Return the TCP ``(n, 3)`` of the reduction with offsets and lengths ``(6,)``, metres."""
        return intersect_spheres(*self._spheres(six, conditions or self.conditions), self.mode)

    def _spheres(self, six: Array, conditions: Conditions) -> tuple[Array, Array]:
        """Return centres ``(n, leg, 3)``, bars carried to the TCP, and radii ``(leg,)``, metres."""
        travel = conditions.command - self.geometry.zero + six[:3]
        centres = self.geometry.centres + travel[..., None] * self.geometry.slides
        return centres, self.geometry.L + six[3:]

    def fit_tcp(self, p: Array) -> Array:
        """Return offsets and lengths ``(6,)`` fitted to the TCP by least squares, Gauss-Newton."""
        six = np.zeros(6)
        for _ in range(_FIT_STEPS):
            centres, radii = self._spheres(six, self.conditions)
            fitted = intersect_spheres(centres, radii, self.mode)
            # Of each leg |p - c| = L: (p - c) . dp = (p - c) . slide d(offset) + L dL
            bars = fitted[:, None] - centres
            slide_slopes = np.einsum("nli,li->nl", bars, self.geometry.slides)[:, None]
            inverse = np.linalg.inv(bars)
            slopes = inverse * slide_slopes, inverse * radii
            columns = np.concatenate(slopes, axis=-1).reshape(-1, 6)
            step = np.linalg.lstsq(columns, (p - fitted).reshape(-1), rcond=None)[0]
            six = six + step
            if np.abs(step).max() < 1e-12:
                return six
        raise NumericsError("the reduction does not converge on the TCP: are the errors absurd?")

    def difference(self, differences: Array) -> Difference:
        """Return mean, largest value and place of differences ``(2 n, 3)`` over the workspace."""
        size = np.linalg.norm(differences, axis=1)
        x, y, z = self.p[np.argmax(size >= size.max() - EQUAL_WITHIN)].tolist()  # the first
        return Difference(float(size.mean()), float(size.max()), (x, y, z))

    def row(self, name: str, value: float, values: Mapping[str, float]) -> Row:
        """Return the comparison for parameters ``values``; name and value are for the table."""
        tcp, rotation = self.mechanism_tcp(values)
        six = self.fit_tcp(tcp)
        effect = None if np.isnan(value) else self.machine.catalogue.effect_of(name)
        nominal = tcp - self.p
        identified, reading_change, reading_rms, reading_max = self._reading_figures(values, tcp)
        return Row(
            name=name,
            effect=effect.name if effect else "",
            unit=effect.unit if effect else ONE,
            value=value,
            nominal=self.difference(nominal),
            translated=self.difference(nominal - nominal.mean(axis=0)),
            fitted=self.difference(tcp - self.reduction_tcp(six)),
            identified=identified,
            six=tuple(six.tolist()),
            rotation=rotation,
            reading_change=reading_change,
            reading_rms=reading_rms,
            reading_max=reading_max,
            legs=self.geometry.leg_names,
        )

    def _reading_figures(
        self, values: Mapping[str, float], tcp: Array
    ) -> tuple[Difference, float, float, float]:
        """Return the figures of a row that come from readings of dials; nan on other layouts."""
        if not self.geometry.dialled:
            return _NO_DIFFERENCE, _NAN, _NAN, _NAN
        change, best, priors = self.fit_reduction_to_readings(values)
        identified = tcp - self.reduction_tcp(priors.values)
        return (
            self.difference(identified - identified.mean(axis=0)),
            float(np.sqrt(np.mean(change**2))),
            float(np.sqrt(np.mean(best.residuals**2))),
            float(np.abs(best.residuals).max()),
        )

    def fit_reduction_to_readings(
        self, values: Mapping[str, float]
    ) -> tuple[Array, reduction.ReadingFit, reduction.ReadingFit]:
        """Return the change of the readings by an effect, datums removed, and two fits of the
        reduction: the best one, and the one that an identification with priors finds.
        """
        campaign, readings = self.campaign, self.model.readings(values, self.campaign)
        datums = np.eye(len(campaign.setups))[campaign.setup]
        change = readings - self.perfect_readings
        change = change - datums @ np.linalg.lstsq(datums, change, rcond=None)[0]
        setups = [campaign.setups[k] for k in campaign.setup]
        tolerances = [self.machine.tolerance(name) for name in self.machine.catalogue.base]
        best, priors = (
            reduction.fit_readings(
                campaign.command,
                campaign.leg,
                [setup.axis for setup in setups],
                [setup.gauge for setup in setups],
                readings,
                READING_LIMIT,
                signs=[setup.sign for setup in setups],
                prior_sd=prior,
                nuisance=datums,
                geometry=self.geometry,
            )
            for prior in (np.inf, np.repeat(tolerances, len(LEGS)))
        )
        return change, best, priors


def compare_effects(
    machine: MachineSource | None = None,
    names: Iterable[str] | None = None,
    circumstances: Circumstances | None = None,
) -> tuple[Row, ...]:
    """Return a row for each effect, at its tolerance on an otherwise perfect machine.

    Args:
        machine: dimensions and tolerances, or the path of its file; its identified parameters are
            left out.
        names: effects, parameters or structured members; where absent all but those of plates, and
            of dials where none stand on legs. Dials by the campaign's first setup.
        circumstances: see there.

    Raises:
        InputError: for a name that is no effect, or one of dials where none stand on legs.
    """
    comparison = Comparison(machine, circumstances)
    plain, dialled = comparison.machine, comparison.geometry.dialled
    setups = [setup.name for setup in comparison.campaign.setups] if dialled else []
    if names is None:
        effects = [e for e in plain.catalogue.values() if not e.of_body]
        names = [e.name for e in effects if dialled or not e.of_dial]
    rows = []
    for name in plain.catalogue.expand(names, setups[:1]):
        if plain.catalogue.effect_of(name).of_dial and not dialled:
            raise InputError(f"{name}: dials are set against the legs of an Orthoglide alone")
        value = plain.tolerance(name)
        weights = plain.catalogue.elementary_weights(name, setups)
        rows.append(comparison.row(name, value, {n: w * value for n, w in weights.items()}))
    return tuple(rows)


def compare_machine(
    machine: MachineSource, circumstances: Circumstances | None = None
) -> tuple[Row, ...]:
    """Return rows for a calibrated machine: all of its parameters together, then each alone.

    Args:
        machine: with the parameters to compare for.
        circumstances: load, warmth, time, pitch and grid of the comparison; usual ones where
            absent.

    Returns:
        Row ``"machine"`` first, then one for every parameter that is not zero.
    """
    machine = Machine.of(machine)
    comparison = Comparison(machine, circumstances)
    effect_of = machine.catalogue.effect_of
    values = {n: value for n, value in machine.values.items() if value and not effect_of(n).of_body}
    single_rows = (comparison.row(name, value, {name: value}) for name, value in values.items())
    return (comparison.row("machine", float("nan"), values), *single_rows)


@dataclass(frozen=True)
class Slice:
    """Difference at the TCP after the fit, on one plane through mechanical zero."""

    normal: int  # base axis across the plane, 0, 1 or 2
    p: Array  # points (n, m, 3), metres, the other two axes in their order along rows and columns
    difference: Array  # the larger of the two visits' (n, m), metres; nan outside the workspace


def slices(
    machine: Machine, points: int = 41, circumstances: Circumstances | None = None
) -> tuple[Slice, ...]:
    """Return the difference of mechanism and fitted reduction on three planes of the workspace,
    with an odd number of points along each side.
    """
    comparison = Comparison(machine, circumstances)
    six = comparison.fit_tcp(comparison.mechanism_tcp(machine.values)[0])
    places = grid(machine.geometry, points)
    planes = []
    for normal in range(3):
        # The section of the cube is at p = 0, whether its grid contains that plane or not.
        used = machine.geometry.dialled | (np.abs(places[:, normal]) < EQUAL_WITHIN)
        plane_points = np.delete(places[used], normal, axis=1)
        p = np.stack(np.meshgrid(*map(np.unique, plane_points.T), indexing="ij"), -1)
        inside = (p[:, :, None] == np.unique(plane_points, axis=0)).all(axis=-1).any(axis=-1)
        p = np.insert(p, normal, 0.0, -1)
        conditions = comparison.circumstances.visit_conditions(
            commands(Spheres.of_geometry(machine.geometry), p[inside])
        )
        tcp, _ = comparison.mechanism_tcp(machine.values, conditions)
        distance = np.linalg.norm(tcp - comparison.reduction_tcp(six, conditions), axis=1)
        size = np.full(p.shape[:2], np.nan)
        size[inside] = distance.reshape(2, -1).max(axis=0)
        planes.append(Slice(normal, p, size))
    return tuple(planes)
