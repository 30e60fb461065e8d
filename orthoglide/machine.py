"""``Machine``: one machine, nominal or calibrated."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.arguments import public
from orthoglide.effects import CATALOGUE, Catalogue, Effect
from orthoglide.errors import ClosureError, InputError, UnreachableError, as_path, check_type
from orthoglide.files import write_file
from orthoglide.geometry import Array, Geometry, Pose, vectors
from orthoglide.machine_file import (
    MachineFile,
    ParameterValue,
    Posterior,
    machine_file_of,
    read_machine_file,
    write_machine_file,
)
from orthoglide.machine_file.values import check_magnitudes, check_sigmas, parameter_entries
from orthoglide.mechanism.engine import batch_index
from orthoglide.mechanism.mechanism import Posture
from orthoglide.mechanism.perfect_legs import commands as commands_of
from orthoglide.observations import Readings
from orthoglide.prediction import Conditions, MeasurementModel, Model
from orthoglide.scene import Posed, drawing
from orthoglide.text import printable_path
from orthoglide.urdf.parallel import held_parameters


@public
@dataclass(frozen=True)
class Machine:
    """One machine: its dimensions, tolerances and identified parameters. Immutable.

    Attributes:
        spec: content of its machine file, SI.
    """

    spec: MachineFile = field(default_factory=MachineFile)

    def __post_init__(self) -> None:
        expected = "a MachineFile, such as MachineFile(geometry=...), or a path to Machine.load"
        check_type("the content of a machine", self.spec, MachineFile, expected)

    def __repr__(self) -> str:
        names = list(self.spec.parameters)
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        errors = (", ".join(names[:3]) or "no errors") + more
        return f"<Machine {self.spec.name!r}: {errors}>"

    @classmethod
    def nominal(cls) -> Machine:
        """The Orthoglide of the papers, without errors."""
        return cls()

    @classmethod
    def of(cls, given: MachineSource | None, effects: Iterable[Effect] = ()) -> Machine:
        """Return a machine given as such, by its file or by dimensions; by default the nominal one.

        Args:
            given: the machine, its file as read, the path of that, or dimensions.
            effects: user-defined effects to add.

        Raises:
            FileError: naming file, line and remedy.
            InputError: for any other type.
        """
        if isinstance(given, str | os.PathLike):
            return cls.load(given, effects)
        machine = given if isinstance(given, Machine) else cls(machine_file_of(given))
        return machine.with_effects(effects)

    @classmethod
    def load(cls, path: str | os.PathLike[str], effects: Iterable[Effect] = ()) -> Machine:
        """Return the machine of a file (``machine.toml``).

        Args:
            path: the file.
            effects: user-defined effects, which the file may name.

        Raises:
            FileError: naming file, line and remedy.
        """
        return cls(read_machine_file(path, CATALOGUE.with_effects(effects)))

    @classmethod
    def from_urdf(
        cls, folder: str | os.PathLike[str], given: MachineSource | None = None
    ) -> Machine:
        """Return a machine with the joint placements of a URDF of three PRPaR legs.

        Args:
            folder: with ``orthoglide.urdf`` and ``orthoglide.closures.toml``.
            given: machine with everything else, nominal where the URDF is an exported one, which
                contains the errors; of its dimensions the command at mechanical zero, the stroke
                and the places of dials are used.

        Raises:
            FileError: where a file is missing or invalid.
            InputError: where the URDF has other legs, or contains the given machine's errors.
        """
        path = as_path(folder).resolve()
        machine = cls(replace(cls.of(given).spec, name=path.name, urdf=str(path)))
        machine.model.engine  # noqa: B018  (reads the files and checks the pivots)
        return machine

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the machine file at ``path``; :meth:`load` reads back the same machine.

        The covariance of its parameters goes beside it, ``machine.npz`` to ``machine.toml``.

        Raises:
            FileError: where the file exists and ``overwrite`` is false.
        """
        write_machine_file(self.spec, path, overwrite=overwrite)

    @property
    def geometry(self) -> Geometry:
        """Nominal dimensions."""
        return self.spec.geometry

    @property
    def catalogue(self) -> Catalogue:
        """Effects that this machine may have."""
        return self.spec.catalogue

    def with_effects(self, effects: Iterable[Effect]) -> Machine:
        """Return this machine with user-defined effects added to its catalogue.

        Raises:
            InputError: where two effects share a name, or a basis does not work on symbols.
        """
        return self._with_catalogue(self.catalogue.with_effects(effects))

    def with_shapes(self) -> Machine:
        """Return this machine with the sizes of its free-form errors as structured members."""
        mean = dict(zip(self.posterior.names, self.posterior.mean.tolist(), strict=True))
        return self._with_catalogue(self.catalogue.with_shapes(mean))

    def _with_catalogue(self, catalogue: Catalogue) -> Machine:
        if catalogue.effects == self.catalogue.effects:
            return self
        model = self.model.with_catalogue(catalogue)
        return self._with_model(replace(self.spec, catalogue=catalogue), model)

    @property
    def values(self) -> dict[str, float]:
        """Parameters that are not zero, SI."""
        return {name: entry.value for name, entry in self.spec.parameters.items()}

    @property
    def posterior(self) -> Posterior:
        """Posterior of the parameters; independent with their sigmas where the file has none."""
        return self.spec.posterior or self.spec.independent

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings from loading the machine, in sentences."""
        return self.spec.warnings

    def tolerance(self, name: str) -> float:
        """Standard deviation to expect of a parameter or family, SI."""
        return self.spec.tolerance[self.catalogue.effect_of(name).name]

    def with_parameters(
        self, values: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Machine:
        """Return this machine with parameters set, SI; a structured member sets the parameters that
        it stands for, and contributions to one parameter are added.

        The covariance of a calibrated machine belongs to other values and is dropped: only the
        standard deviations of its parameters are kept.

        Args:
            values: such as ``{"joint_offset.x": 1e-3, "axis_tilt.cyclic": 2e-3}``.
            sigmas: standard deviations of some of them; 0 (known) where not given.

        Raises:
            InputError: for a name that is no parameter of the machine or is specific to a
                campaign, a value that is no number or is in another unit, and a standard deviation
                that is invalid or belongs to another parameter.
        """
        check_magnitudes(self.spec, values)
        return self._with_entries(dict(self.spec.parameters), values, sigmas or {})

    def with_only(self, values: Mapping[str, float]) -> Machine:
        """Return this machine with only these parameters, SI; names as for `with_parameters`."""
        return self._with_entries({}, values, {})

    def with_posterior(self, values: Mapping[str, float], posterior: Posterior) -> Machine:
        """Return this machine with only these parameters, and their posterior.

        Args:
            values: elementary parameters, SI.
            posterior: of these parameters about ``values``, and of others about 0.

        Raises:
            InputError: for a name that is no single parameter of the machine.
        """
        for name in posterior.names:
            if name not in self.catalogue.motions:
                raise InputError(f"a covariance must be of single parameters, not of {name!r}")
        return self._with_entries({}, values, posterior.sigmas, posterior.recentred(values))

    def with_provenance(self, provenance: Mapping[str, Any]) -> Machine:
        """Return this machine with the provenance of its parameters."""
        return self._with_model(replace(self.spec, provenance=dict(provenance)), self.model)

    def _with_entries(
        self,
        entries: dict[str, ParameterValue],
        values: Mapping[str, float],
        sigmas: Mapping[str, float],
        posterior: Posterior | None = None,
    ) -> Machine:
        if posterior is None:
            check_sigmas(values, sigmas)
        parameters = entries | parameter_entries(self.catalogue, values, sigmas)
        spec = replace(self.spec, parameters=parameters, posterior=posterior, warnings=())
        return self._with_model(replace(spec, file="", sha256=""), self.model)

    def _with_model(self, spec: MachineFile, model: Model) -> Machine:
        """Return a machine with a model that others have too."""
        machine = Machine(spec)
        machine.__dict__["model"] = model
        return machine

    @cached_property
    def model(self) -> Model:
        """The general mechanism with this machine's dimensions, which machines of the same tree
        share; it is built when it is first used.

        Raises:
            InputError: where the URDF of the machine's file contains the machine's errors already.
        """
        spec = self.spec
        held = held_parameters(spec.urdf) if spec.urdf else {}
        if held and all(np.isclose(self.values.get(n, 0.0), v, atol=0.0) for n, v in held.items()):
            raise InputError(
                f"the URDF in {printable_path(spec.urdf)} contains the errors of this machine "
                f"already, and they would count twice: give it with the nominal machine"
            )
        return Model(spec.geometry, spec.screw_pitch, spec.stiffness, spec.catalogue, spec.urdf)

    def by_pinocchio(self) -> Machine:
        """Return this machine with every posture closed by Pinocchio itself, which is slow."""
        return self._with_model(self.spec, self.model.by_pinocchio())

    @cached_property
    def _theta(self) -> Array:
        """All parameters of the machine as the model takes them."""
        return self.model.displacement_model.parameter_vector(self.values)

    def pose(self, rho: ArrayLike, **conditions: ArrayLike) -> Pose:
        """Return the pose of the platform.

        Args:
            rho: commands ``(..., 3)``, metres (2008, eq. 2).
            conditions: where effects depend on them: ``approach (..., 3)``, +1, -1, or 0 for
                unknown (the middle of the dead band); ``time``, ``warming``, ``load (...)``.

        Raises:
            ClosureError: where a posture does not close.
            InputError: for commands or conditions that are not numbers or have the wrong shape,
                or commands so large that they must be millimetres.
        """
        commands = self.geometry.commands(rho)
        at_commands = Conditions.from_commands(commands, **conditions)
        try:
            out = self.model.outputs(self._theta, at_commands)
        except ClosureError as error:
            error.index = batch_index(commands.shape[:-1], error.index)
            raise
        return Pose(out.p.reshape(commands.shape), out.R.reshape(*commands.shape, 3))

    def close(self, rho: ArrayLike, **conditions: ArrayLike) -> Posture:
        """Close one posture in Pinocchio and return all its joints, errors of the parts included.

        Args:
            rho: command ``(3,)``, metres.
            conditions: as for :meth:`pose`.

        Raises:
            ClosureError: where the posture does not close, with the residual by loop.
        """
        command = self.geometry.commands(rho)
        if command.shape != (3,):
            raise InputError(f"close takes one command of shape (3,), not {command.shape}")
        at_command = Conditions.from_commands(command, **conditions)
        moves = self.model.loaded_displacements(self.values, at_command)
        return self.model.mechanism.close(command, moves.reshape(3, -1))

    def posed(self, rho: ArrayLike | None = None) -> Posed:
        """Return the machine for drawings, at a command ``(3,)`` or at mechanical zero."""
        command = self.geometry.zero if rho is None else self.geometry.commands(rho)
        out = self.model.outputs(self.values, Conditions.from_commands(command))
        return Posed(self.geometry, out.lines[0], out.p[0], command - self.geometry.zero)

    def show(
        self,
        rho: ArrayLike | None = None,
        *,
        magnify: float = 1.0,
        out: str | os.PathLike[str] | None = None,
        open_browser: bool = False,
        **conditions: ArrayLike,
    ) -> Any:
        """Show the machine, its loops closed, in Pinocchio's meshcat viewer, which is returned.

        Args:
            rho: command ``(3,)``, metres; mechanical zero where absent.
            magnify: factor by which errors are enlarged; beyond 1 the nominal machine stands beside
                them in grey.
            out: page to write, one file that needs no network; none where absent.
            open_browser: whether a browser opens at the viewer's address.
            conditions: as for :meth:`pose`.

        Raises:
            InputError: where meshcat is missing, or the loops do not close with enlarged errors.
            FileError: where ``out`` exists.
        """
        from orthoglide.viewer import MagnifiedMachine, show, static_page

        command = self.geometry.zero if rho is None else self.geometry.commands(rho)
        machine = MagnifiedMachine(self.model, self.values, conditions, magnify)
        viewer = show(machine, command, open_browser=open_browser)
        if out is not None:
            write_file(out, static_page(viewer, machine, self.spec.title), overwrite=False)
        return viewer

    def _repr_svg_(self) -> str:
        title = f"The machine {self.spec.name}".rstrip()
        return drawing(self.posed(), title=title, standalone=True)

    def bar_tensions(self, rho: ArrayLike, **conditions: ArrayLike) -> Array:
        """Return the tension of the bars ``(..., leg, bar)`` under a ``load``, newtons; arguments
        as for :meth:`pose`.
        """
        commands = self.geometry.commands(rho)
        at_commands = Conditions.from_commands(commands, **conditions)
        tensions = self.model.tensions(self.values, at_commands)
        return tensions.reshape(*commands.shape, 2)

    def forward(self, rho: ArrayLike, **conditions: ArrayLike) -> Array:
        """Return the TCP ``(..., 3)``, metres, of commands; arguments as for :meth:`pose`."""
        return self.pose(rho, **conditions).p

    def jacobian(self, rho: ArrayLike, **conditions: ArrayLike) -> Array:
        """Return dp/drho ``(..., 3, 3)`` of the TCP; arguments as for :meth:`pose`."""
        commands = self.geometry.commands(rho)
        rates = self.model.jacobian(self.values, Conditions.from_commands(commands, **conditions))
        return rates.reshape(*commands.shape, 3)

    def inverse(self, p: ArrayLike, **conditions: ArrayLike) -> Array:
        """Return the commands ``(..., 3)`` that bring the TCP to ``p`` ``(..., 3)``, metres.

        Effects depend on the command, so the command is corrected until the predicted TCP is ``p``.
        The ``conditions`` are as for :meth:`pose`.

        Raises:
            UnreachableError: naming the leg that is too short.
            ClosureError: where the drives do not converge.
        """
        goal = vectors(p, "p")
        spheres = self.model.mechanism.spheres
        try:
            rho = commands_of(spheres, goal.reshape(-1, 3)).reshape(goal.shape)
        except UnreachableError as error:
            error.index = batch_index(goal.shape[:-1], error.index)
            raise
        for _ in range(30):
            miss = goal - self.forward(rho, **conditions)
            largest = np.abs(miss).max(initial=0.0)
            if largest < 1e-13:
                return rho
            rho = rho + np.linalg.solve(self.jacobian(rho, **conditions), miss[..., None])[..., 0]
        if largest < 1e-11:
            return rho
        raise ClosureError("the drives do not converge on the wanted points")

    def readings(self, given: Readings) -> Array:
        """Return the expected readings ``(n,)`` without datums, metres or radians."""
        return MeasurementModel(given).predict(self.model, self.values)


MachineSource = Machine | MachineFile | Geometry | str | os.PathLike[str]
"""A machine, its file as read, the path of that, or dimensions with defaults otherwise."""
