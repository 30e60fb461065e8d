"""What is known of one machine, in memory (SI)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.add_ons import MARK_KEY, Kinematics, Printer, add_on, firmware_table
from orthoglide.effects import CATALOGUE, Catalogue
from orthoglide.errors import InputError
from orthoglide.geometry import Array, Geometry
from orthoglide.layout import ORTHOGLIDE, LinearDelta
from orthoglide.machine_file.measured import Measured
from orthoglide.machine_file.posterior import Posterior
from orthoglide.parameters import Parameter
from orthoglide.reduction.spheres import intersect_spheres

Triple = tuple[float, float, float]

SCHEMA_VERSION = 1
"""Version of the machine file that this package reads and writes."""


@dataclass(frozen=True)
class Dial:
    """The dial, in metres.

    Attributes:
        resolution: step of the display.
        repeatability: standard deviation of one reading, where it is known.
        placement: standard deviation of where the dial stands along a leg.
    """

    resolution: float = 1e-5
    repeatability: float | None = None
    placement: float = 1e-3


@dataclass(frozen=True)
class Instrument:
    """How well an instrument other than a dial on a leg reads, metres (radians of a level).

    Attributes:
        resolution: step of its display, where it matters.
        repeatability: standard deviation of one reading, where it is known.
    """

    resolution: float | None = None
    repeatability: float | None = None


@dataclass(frozen=True)
class Controller:
    """How the controller counts: travel from mechanical zero = sign (shown - zero), by axis."""

    zero: Triple = (0.0, 0.0, 0.0)  # what it shows at mechanical zero, metres
    # +1 where it counts away from the origin, -1 where toward it
    sign: tuple[int, int, int] = (1, 1, 1)

    def to_rho(self, travel: ArrayLike, geometry: Geometry) -> Array:
        """Commands ``(..., 3)`` of controller values ``(..., 3)``, both metres."""
        shown = np.asarray(travel, dtype=float)
        return geometry.zero + np.array(self.sign) * (shown - np.array(self.zero))

    def from_rho(self, rho: ArrayLike, geometry: Geometry) -> Array:
        """Controller values ``(..., 3)`` of commands ``(..., 3)``, both metres."""
        travel = np.asarray(rho, dtype=float) - geometry.zero
        return np.array(self.zero) + np.array(self.sign) * travel


_STIFF_LEG_TORSION = 1e4
"""Torsional stiffness of a leg, N m/rad, from which it matters: at ten times that, a mismatch of
the bars shows by half (elastic equilibrium of bars of EA/L = 5e7 N/m)."""


@dataclass(frozen=True)
class Stiffness:
    """Elastic constants, where they are known.

    Attributes:
        torsion: torsional stiffness of a leg, N m/rad; kept with the file, but not modelled.
        bar: axial stiffness of a bar, N/m; rigid bars where absent.
    """

    torsion: float | None = None
    bar: float | None = None

    def __post_init__(self) -> None:
        if self.bar is not None and not 0 < self.bar < np.inf:
            raise InputError(f"a bar's stiffness must be positive, in N/m, not {self.bar}")
        if self.torsion is not None and not 0 <= self.torsion < np.inf:
            raise InputError(
                f"torsional stiffness must not be negative, in N m/rad, not {self.torsion}"
            )

    def warnings(self, file: str) -> tuple[str, ...]:
        """Return what a user should know of what a file says of it, in sentences."""
        if self.torsion is None:
            return ()
        return (
            f"{file}: torsion_Nmm_per_rad is no longer modelled. Below {_STIFF_LEG_TORSION / 1e-3:.0e} "
            f"N mm/rad a leg's torsion changes results by less than 5 %; this file has "
            f"{self.torsion / 1e-3:.3g}",
        )


@dataclass(frozen=True)
class ParameterValue:
    """An identified parameter: value and standard deviation in SI, and the unit files show."""

    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class DeltaKinematics:
    """Kinematics of a delta without errors: the tool is where three spheres meet."""

    # where the tool stood if an arm hung straight down from its carriage at mechanical zero, and
    # had no length (3, 3), metres, by leg
    sphere_centres_at_zero: Array
    arm_lengths: Array  # length of each leg's arm (3,), metres

    def travel(self, p: Array) -> Array:
        """Travel of the carriages from mechanical zero ``(n, 3)`` for places ``(n, 3)``, metres;
        nan where an arm does not reach.
        """
        apart = p[:, None] - self.sphere_centres_at_zero
        square = self.arm_lengths**2 - np.sum(apart[:, :, :2] ** 2, axis=-1)
        return np.asarray(apart[:, :, 2] + np.sqrt(np.where(square > 0, square, np.nan)))

    def places(self, travel: Array) -> Array:
        """Places of the tool ``(n, 3)`` at a travel ``(n, 3)``, metres.

        Raises:
            UnreachableError: where the arms do not meet.
        """
        centres = self.sphere_centres_at_zero + travel[:, :, None] * np.array([0.0, 0.0, 1.0])
        return intersect_spheres(centres, self.arm_lengths)

    @classmethod
    def from_geometry(cls, geometry: Geometry) -> DeltaKinematics:
        """Return the kinematics of the nominal machine."""
        joints = [leg.carriage - leg.platform for leg in geometry.legs]
        return cls(np.array(joints), np.full(3, geometry.L))


@dataclass(frozen=True)
class MachineFile:
    """What a machine file holds, SI; of the Orthoglide of the 2008 chapter where nothing is given.

    Attributes:
        name: of the machine, for people.
        geometry: nominal dimensions.
        dial: the dial used.
        instruments: other instruments, by kind of reading.
        screw_pitch: lead of the drives' screws, metres; None: a screw error is no candidate.
        controller: the controller's zero and sign.
        tolerance: standard deviation to expect, by family; defaults fill what is not given.
        surface_slope: standard deviation of the slope of the reference surface of readings of kind
            ``parallelism``, radians; None: the surface is taken as exact.
        measured: what an owner measured on the machine itself.
        stiffness: elastic constants.
        urdf: folder of a URDF and its closures that say where the joints are; ``""``: the
            dimensions do.
        parameters: identified parameters of a calibrated machine, by name.
        provenance: where the parameters come from.
        catalogue: the effects that the parameters belong to.
        file: the file's name as the caller gave it, or ``""``.
        sha256: digest of the file, or ``""``.
        posterior: covariance of the parameters, where it was kept.
        warnings: what was noticed on reading and is no error.
        build: class of the machine, ``laboratory`` or ``belts``, which sets the tolerances that are
            not given; empty: belts of a linear delta, a laboratory of others.
    """

    name: str = "Orthoglide, nominal"
    geometry: Geometry = field(default_factory=Geometry)
    dial: Dial = field(default_factory=Dial)
    instruments: Mapping[str, Instrument] = field(default_factory=dict)
    screw_pitch: float | None = None
    controller: Controller = field(default_factory=Controller)
    tolerance: Mapping[str, float] = field(default_factory=dict)
    surface_slope: float | None = None
    measured: Measured = field(default_factory=Measured)
    stiffness: Stiffness = field(default_factory=Stiffness)
    urdf: str = ""
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    catalogue: Catalogue = CATALOGUE
    file: str = field(default="", compare=False)
    sha256: str = field(default="", compare=False)
    posterior: Posterior | None = field(default=None, compare=False, repr=False)
    warnings: tuple[str, ...] = field(default=(), compare=False)
    build: str = ""

    @property
    def title(self) -> str:
        """What a page calls the machine, whether it has a name or not."""
        return self.name or "The machine"

    @property
    def independent(self) -> Posterior:
        """The parameters as independent Gaussians with their standard deviations, but for what was
        measured of several together.
        """
        known = {n: e for n, e in self.parameters.items() if e.sigma > 0}
        mean = np.array([entry.value for entry in known.values()])
        covariance = np.diag(np.square([entry.sigma for entry in known.values()]))
        place = {name: k for k, name in enumerate(known)}
        for names, _, among in self._measured_priors:
            at = [place[name] for name in names if name in place]
            if len(at) == len(names):
                covariance[np.ix_(at, at)] = among
        return Posterior(tuple(known), mean, covariance)

    @property
    def _measured_priors(self) -> list[tuple[tuple[Parameter, ...], float, Array]]:
        return [*self.measured.parameter_priors(self.catalogue, self.geometry, self.tolerance)]

    @property
    def is_measured(self) -> bool:
        """Whether what is known of its parameters was measured on the machine itself, and is no
        calibration from which it may have changed.
        """
        return self.measured != Measured() and self.posterior is None

    def with_measured(self) -> MachineFile:
        """Return the same with what was measured among its parameters."""
        known = {
            str(name): ParameterValue(value, float(np.sqrt(among[k, k])), effect.unit.name)
            for names, value, among in self._measured_priors
            for k, name in enumerate(names)
            if (effect := self.catalogue.effect_of(name))
            and (name not in self.parameters or not self.parameters[name].sigma)
        }
        return replace(self, parameters={**self.parameters, **known}) if known else self

    @property
    def firmware(self) -> str:
        """Mark of the firmware's numbers that travel was computed with; empty of others."""
        return str(firmware_table(self.provenance)[1].get(MARK_KEY, ""))

    @cached_property
    def printer(self) -> Printer | None:
        """The numbers of the firmware that the machine was imported from; ``None`` of others."""
        name, table = firmware_table(self.provenance)
        return add_on(name).stored(table) if name else None

    @property
    def kinematics(self) -> Kinematics | None:
        """Where the controller of a delta sends the carriages for a place, by its firmware's
        numbers where these are known; ``None`` of other machines.
        """
        if not isinstance(self.geometry.layout, LinearDelta):
            return None
        if self.printer is None:
            return DeltaKinematics.from_geometry(self.geometry)
        return self.printer.kinematics

    def __post_init__(self) -> None:
        if self.name == MachineFile.name and self.geometry.layout != ORTHOGLIDE:
            object.__setattr__(self, "name", default_machine_name(self.geometry))
        object.__setattr__(self, "catalogue", self.catalogue.for_layout(self.geometry.layout))
        known = self.catalogue
        expected = known.belt_tolerance if self._has_belts else known.default_tolerance
        object.__setattr__(self, "tolerance", {**expected, **self.tolerance})

    @property
    def _has_belts(self) -> bool:
        """Whether it is of the class of belts."""
        hanging = isinstance(self.geometry.layout, LinearDelta)
        return self.build == "belts" or (not self.build and hanging)

    @property
    def entered(self) -> dict[str, float]:
        """Standard deviations to expect, by family, of what parts of one set have in common beyond
        their tolerances, because an owner entered it, SI; at least as much as the entered values of
        parts that are alike differ by.
        """
        found = dict(self.catalogue.common_tolerance) if self._has_belts else {}
        for name, sd in found.items():
            own = (
                v for k, v in self.parameters.items() if self.catalogue.effect_of(k).name == name
            )
            found[name] = max(sd, float(np.ptp([0.0, *(v.value for v in own if not v.sigma)])))
        return found


def default_machine_name(geometry: Geometry) -> str:
    """Return what a machine of given dimensions is called until somebody names it."""
    if geometry == Geometry():
        return MachineFile().name
    kinds = {"orthoglide": "Orthoglide", "linear-delta": "Linear delta", "legs": "Three legs"}
    bars = "arms" if geometry.layout.kind == "linear-delta" else "bars"
    return f"{kinds[geometry.layout.kind]}, {bars} of {geometry.L * 1e3:g} mm"
