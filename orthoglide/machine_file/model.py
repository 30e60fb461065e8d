"""Content of a machine file in memory (SI)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.add_ons import MARK_KEY, Printer, add_on, firmware_table
from orthoglide.arguments import public
from orthoglide.effects import CATALOGUE, Catalogue
from orthoglide.errors import InputError
from orthoglide.geometry import Array, Geometry, plane_columns
from orthoglide.layout import ORTHOGLIDE, LinearDelta
from orthoglide.layout.leg import Triple
from orthoglide.machine_file.measured import Measured
from orthoglide.machine_file.posterior import Posterior
from orthoglide.notes import Note
from orthoglide.parameters import Parameter
from orthoglide.reduction.spheres import intersect_spheres

SCHEMA_VERSION = 1
"""Version of the machine file that this package reads and writes."""


@public
@dataclass(frozen=True)
class Instrument:
    """Accuracy of an instrument, metres (radians of a level).

    Attributes:
        resolution: step of its display, if it matters.
        repeatability: standard deviation of one reading, if known.
    """

    resolution: float | None = None
    repeatability: float | None = None


@public
@dataclass(frozen=True)
class Dial(Instrument):
    """Accuracy of the dial on the legs, metres.

    Attributes:
        placement: standard deviation of its position along a leg.
    """

    resolution: float = 1e-5
    placement: float = 1e-3


@dataclass(frozen=True)
class Controller:
    """How the controller counts: travel from mechanical zero = sign (shown - zero), by axis."""

    zero: Triple = (0.0, 0.0, 0.0)  # what it shows at mechanical zero, metres
    # +1 where it counts away from the origin, -1 where toward it
    sign: tuple[int, int, int] = (1, 1, 1)

    def to_rho(self, shown: ArrayLike, geometry: Geometry) -> Array:
        """Return commands ``(..., 3)`` from controller values ``(..., 3)``, both metres."""
        difference = np.asarray(shown, dtype=float) - np.array(self.zero)
        return geometry.zero + np.array(self.sign) * difference

    def from_rho(self, rho: ArrayLike, geometry: Geometry) -> Array:
        """Return controller values ``(..., 3)`` from commands ``(..., 3)``, both metres."""
        travel = np.asarray(rho, dtype=float) - geometry.zero
        return np.array(self.zero) + np.array(self.sign) * travel


_STIFF_LEG_TORSION = 1e4
"""Torsional stiffness of a leg, N m/rad, from which it matters: at ten times that, half of a
mismatch of the bars is visible (elastic equilibrium of bars of EA/L = 5e7 N/m)."""


@dataclass(frozen=True)
class Stiffness:
    """Elastic constants, if known."""

    # torsional stiffness of a leg, N m/rad; kept with the file, but not modelled
    torsion: float | None = None
    bar: float | None = None  # axial stiffness of a bar, N/m; rigid bars where absent

    def __post_init__(self) -> None:
        if self.bar is not None and not 0 < self.bar < np.inf:
            raise InputError(f"a bar's stiffness must be positive, in N/m, not {self.bar}")

    def warnings(self, file: str) -> tuple[Note, ...]:
        """Return warnings about the constants of a file."""
        if self.torsion is None:
            return ()
        limit = f"{_STIFF_LEG_TORSION / 1e-3:.0e}"
        return (Note(
            f"{file}: torsion_Nmm_per_rad is no longer modelled. Below {limit} N mm/rad a leg's "
            f"torsion changes results by less than 5 %; this file has {self.torsion / 1e-3:.3g}",
            "stiffness",
        ),)  # fmt: skip


@dataclass(frozen=True)
class ParameterValue:
    """An identified parameter: value and standard deviation in SI, and its unit in files."""

    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class DeltaKinematics:
    """Kinematics of a delta without errors: the tool is the intersection of three spheres."""

    # carriage joint minus platform joint of each leg at mechanical zero (3, 3), metres
    sphere_centres_at_zero: Array
    arm_lengths: Array  # length of each leg's arm (3,), metres

    def travel(self, p: Array) -> Array:
        """Return the carriages' travel from mechanical zero ``(n, 3)`` for tool positions
        ``(n, 3)``, metres; nan where an arm does not reach.
        """
        offset = p[:, None] - self.sphere_centres_at_zero
        square = self.arm_lengths**2 - np.sum(offset[:, :, :2] ** 2, axis=-1)
        return np.asarray(offset[:, :, 2] + np.sqrt(np.where(square > 0, square, np.nan)))

    def places(self, travel: Array) -> Array:
        """Return the tool's positions ``(n, 3)`` at a travel ``(n, 3)``, metres.

        Raises:
            UnreachableError: where the arms do not meet.
        """
        centres = self.sphere_centres_at_zero + travel[:, :, None] * np.array([0.0, 0.0, 1.0])
        clockwise = np.linalg.det(plane_columns(self.sphere_centres_at_zero)) < 0
        # The tool hangs below the carriages, in whichever order the towers are numbered.
        return intersect_spheres(centres, self.arm_lengths, "other" if clockwise else "machine")


_FITTED_SCALE_SD = 4.2e-3
"""Relative error of bars that were fitted to sizes of a printed part, whose shrinkage the firmware
ignores: the root mean square of 0.3 +- 0.3 %."""


@public
@dataclass(frozen=True)
class MachineFile:
    """Content of a machine file, SI; the Orthoglide of the 2008 chapter by default.

    Attributes:
        name: of the machine, for people.
        geometry: nominal dimensions.
        dial: the dial used.
        instruments: other instruments, by kind of reading.
        screw_pitch: lead of the drives' screws, metres; None: a screw error is no candidate.
        controller: the controller's zero and sign.
        tolerance: expected standard deviation by effect; defaults fill what is not given.
        surface_slope: standard deviation of the slope of the reference surface of readings of kind
            ``parallelism``, radians; None: the surface is taken as exact.
        measured: dimensions measured on the machine itself.
        stiffness: elastic constants.
        urdf: folder of a URDF and its closures that state where the joints are; if empty, the
            dimensions do.
        parameters: identified parameters of a calibrated machine, by name.
        provenance: where the parameters come from.
        catalogue: the effects that the parameters belong to.
        file: the file's name as the caller gave it, or ``""``.
        sha256: digest of the file, or ``""``.
        posterior: covariance of the parameters, if it was kept.
        warnings: remarks on reading that are no errors.
        build: class of the machine, ``laboratory`` or ``belts``, which sets the tolerances that are
            not given; if empty, a linear delta has belts, other machines are of a laboratory.
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
    warnings: tuple[Note, ...] = field(default=(), compare=False)
    build: str = ""

    @property
    def title(self) -> str:
        """Name of the machine for pages."""
        return self.name or "The machine"

    @property
    def independent(self) -> Posterior:
        """The parameters as Gaussians, independent except where several were measured together."""
        uncertain = {n: e for n, e in self.parameters.items() if e.sigma > 0}
        mean = np.array([entry.value for entry in uncertain.values()])
        covariance = np.diag(np.square([entry.sigma for entry in uncertain.values()]))
        names = tuple(uncertain)
        for together, _, measured_covariance in self._measured_priors:
            if uncertain.keys() >= set(together):
                places = [names.index(name) for name in together]
                covariance[np.ix_(places, places)] = measured_covariance
        return Posterior(names, mean, covariance)

    @property
    def _measured_priors(self) -> list[tuple[tuple[Parameter, ...], float, Array]]:
        return [*self.measured.parameter_priors(self.catalogue, self.geometry, self.tolerance)]

    @property
    def is_inconclusive(self) -> bool:
        """Whether the parameters are of a calibration whose causes left significant residuals.

        Without these causes, which are not in the file, they tell nothing before new readings. A
        base model alone that does not fit has sigmas that contain its residual.
        """
        return self.provenance.get("verdict") == "partial"

    @property
    def is_calibrated(self) -> bool:
        """Whether the parameters are of an earlier calibration, from which the machine may have
        changed: not measured on the machine itself, nor inconclusive.
        """
        is_measured = self.measured != Measured() and self.posterior is None
        return not is_measured and not self.is_inconclusive

    @property
    def prior(self) -> Posterior:
        """What is known of the parameters before new readings: by an earlier calibration, if it is
        conclusive, otherwise by what was measured on the machine.
        """
        if self.is_inconclusive:
            return replace(self, parameters={}).with_measured().independent
        return self.posterior or self.independent

    def with_measured(self) -> MachineFile:
        """Return the machine with the measured dimensions among its parameters."""
        parameters = dict(self.parameters)
        for names, value, covariance in self._measured_priors:
            for name, sd in zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True):
                if name not in parameters or not parameters[name].sigma:
                    unit = self.catalogue.effect_of(name).unit.name
                    parameters[str(name)] = ParameterValue(value, sd, unit)
        return replace(self, parameters=parameters)

    @property
    def firmware(self) -> str:
        """Identifier of the firmware's numbers with which travel was computed; empty if none."""
        return str(firmware_table(self.provenance)[1].get(MARK_KEY, ""))

    @cached_property
    def printer(self) -> Printer | None:
        """The numbers of the firmware from which the machine was imported; ``None`` if none."""
        name, table = firmware_table(self.provenance)
        return add_on(name).stored(table) if name else None

    @property
    def kinematics(self) -> DeltaKinematics | None:
        """Kinematics of a delta's controller, from its firmware's numbers if known; ``None`` for
        other machines.
        """
        if not isinstance(self.geometry.layout, LinearDelta):
            return None
        if self.printer is None:
            return DeltaKinematics(self.geometry.centres, np.full(3, self.geometry.L))
        return self.printer.kinematics

    @property
    def meshes_relative(self) -> bool:
        """Whether the heights of one list of touches have no common zero with those of another."""
        return self.printer is None or self.printer.meshes_relative

    def __post_init__(self) -> None:
        if self.name == MachineFile.name and self.geometry.layout != ORTHOGLIDE:
            object.__setattr__(self, "name", default_machine_name(self.geometry))
        object.__setattr__(self, "catalogue", self.catalogue.for_layout(self.geometry.layout))
        catalogue = self.catalogue
        defaults = catalogue.belt_tolerance if self._has_belts else catalogue.default_tolerance
        object.__setattr__(self, "tolerance", {**defaults, **self.tolerance})

    @property
    def _has_belts(self) -> bool:
        """Whether the machine is of class ``belts``."""
        is_delta = isinstance(self.geometry.layout, LinearDelta)
        return self.build == "belts" or (not self.build and is_delta)

    @property
    def shared_errors(self) -> list[tuple[dict[str, float], float]]:
        """Weights of parameters that are one number of a firmware, or that it fitted together, and
        the standard deviation of the error that they share beside their own ones, SI. A radius that
        was fitted together with wrong arms errs by as much as these.
        """
        shared = dict(self.catalogue.shared_tolerance) if self._has_belts else {}
        for name, sd in self.fitted.items():
            shared = {key: max(sd, other) for key, other in shared.items()}
            shared[f"{name}.common"] = sd
        return [(self.catalogue.elementary_weights(name), sd) for name, sd in shared.items()]

    @property
    def entered(self) -> dict[str, float]:
        """Expected standard deviations, by effect, of the common error that parts of one set have
        because their size was entered by hand, SI.
        """
        return {name: sd for name, sd in self._common_sds.items() if not self._stored_range(name)}

    @property
    def fitted(self) -> dict[str, float]:
        """Expected standard deviations, by effect, of the common error of parts of one set whose
        stored sizes differ from each other or from the nominal one, SI: nobody enters them so, they
        are a firmware's fit to distances.

        Fitted sizes say no more of the parts than these distances do. A wrong distance widens the
        range of the sizes, and shrinkage of the print scales all.
        """
        return {
            name: float(np.hypot(spread, _FITTED_SCALE_SD * self.geometry.L))
            for name in self._common_sds if (spread := self._stored_range(name))
        }  # fmt: skip

    @property
    def _common_sds(self) -> dict[str, float]:
        return self.catalogue.common_tolerance if self._has_belts else {}

    def _stored_range(self, name: str) -> float:
        """Return the range of the values of an effect that are stored without a standard deviation,
        0 included, SI.
        """
        values = [
            v.value for k, v in self.parameters.items()
            if not v.sigma and self.catalogue.effect_of(k).name == name
        ]  # fmt: skip
        return float(np.ptp([0.0, *values]))


def default_machine_name(geometry: Geometry) -> str:
    """Return the name of a machine of given dimensions that has no name of its own."""
    if geometry == Geometry():
        return MachineFile().name
    kinds = {"orthoglide": "Orthoglide", "linear-delta": "Linear delta", "legs": "Three legs"}
    bars = "arms" if geometry.layout.kind == "linear-delta" else "bars"
    return f"{kinds[geometry.layout.kind]}, {bars} of {geometry.L * 1e3:g} mm"
