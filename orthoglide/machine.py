"""``Machine``: what a user keeps of one Orthoglide, nominal or calibrated."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.effects import CATALOGUE, Catalogue, Effect
from orthoglide.errors import ClosureError, InputError, UnreachableError, as_path
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
from orthoglide.machine_file.values import (
    check_magnitudes,
    check_sigmas,
    parameter_entries,
    refuse_structured_members,
)
from orthoglide.mechanism.engine import Outputs, batch_index
from orthoglide.mechanism.mechanism import Posture
from orthoglide.mechanism.perfect_legs import commands as commands_of
from orthoglide.observations import Readings
from orthoglide.prediction import Conditions, Model
from orthoglide.scene import Posed, drawing


@dataclass(frozen=True)
class Machine:
    """One machine: its dimensions, tolerances and identified parameters. Immutable.

    Attributes:
        spec: everything its machine file holds, SI.
    """

    spec: MachineFile = field(default_factory=MachineFile)

    def __post_init__(self) -> None:
        if not isinstance(self.spec, MachineFile):
            raise InputError(
                f"a {type(self.spec).__name__} is no machine file: give MachineFile(geometry=...), "
                f"or a path to Machine.load"
            )

    def __repr__(self) -> str:
        names = list(self.spec.parameters)
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        errors = ", ".join(names[:3]) + more if names else "no errors"
        return f"<Machine {self.spec.name!r}: {errors}>"

    @classmethod
    def nominal(cls) -> Machine:
        """The Orthoglide of the papers, without errors."""
        return cls()

    @classmethod
    def of(cls, given: MachineSource | None, effects: Iterable[Effect] = ()) -> Machine:
        """Return a machine as it is, from its file or of dimensions; by default the nominal one.

        Args:
            given: the machine, its file as read, the path of that, or dimensions.
            effects: of one's own, known besides.

        Raises:
            FileError: naming file, line and remedy.
            InputError: for what is neither.
        """
        if isinstance(given, str | os.PathLike):
            return cls.load(given, effects)
        machine = given if isinstance(given, Machine) else cls(machine_file_of(given))
        return machine.with_effects(effects)

    @classmethod
    def load(cls, path: str | os.PathLike[str], effects: Iterable[Effect] = ()) -> Machine:
        """A machine from its file (``machine.toml``).

        Args:
            path: the file.
            effects: of one's own, which the file may name.

        Raises:
            FileError: naming file, line and remedy.
        """
        spec = read_machine_file(path, CATALOGUE.with_effects(effects))
        refuse_structured_members(spec)
        return cls(spec)

    @classmethod
    def from_urdf(
        cls, folder: str | os.PathLike[str], given: MachineSource | None = None
    ) -> Machine:
        """Return a machine whose joints are where a URDF of three PRPaR legs says.

        Args:
            folder: with ``orthoglide.urdf`` and ``orthoglide.closures.toml``.
            given: the rest; of its dimensions the command at mechanical zero, the stroke and the
                places of dials are used.

        Raises:
            FileError: where a file is missing or says what cannot be.
            InputError: where the URDF has other legs.
        """
        path = as_path(folder).resolve()
        machine = cls(replace(cls.of(given).spec, name=path.name, urdf=str(path)))
        machine.model.engine  # noqa: B018  (which reads the files, and looks at the pivots)
        return machine

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the machine file at ``path``; :meth:`load` reads back the same machine.

        The covariance of its parameters goes beside it, ``machine.npz`` to ``machine.toml``.

        Raises:
            FileError: where a file stands already and ``overwrite`` is false.
        """
        write_machine_file(self.spec, path, overwrite=overwrite)

    @property
    def geometry(self) -> Geometry:
        """Nominal dimensions."""
        return self.spec.geometry

    @property
    def catalogue(self) -> Catalogue:
        """The effects that this machine may have."""
        return self.spec.catalogue

    def with_effects(self, effects: Iterable[Effect]) -> Machine:
        """The same machine, with a user's own effects beside those it knows.

        Raises:
            InputError: where two effects share a name, or a basis does not work on symbols.
        """
        catalogue = self.catalogue.with_effects(effects)
        if catalogue.effects == self.catalogue.effects:
            return self
        machine = Machine(replace(self.spec, catalogue=catalogue))
        machine.__dict__["_models"] = [m.with_catalogue(catalogue) for m in self._models]
        return machine

    @property
    def values(self) -> dict[str, float]:
        """Parameters that are not zero, SI."""
        return {name: entry.value for name, entry in self.spec.parameters.items()}

    @property
    def posterior(self) -> Posterior:
        """What is known of the parameters; independent by their sigmas where no more is."""
        return self.spec.posterior or self.spec.independent

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was noticed when the machine was loaded, in sentences."""
        return self.spec.warnings

    def tolerance(self, name: str) -> float:
        """Standard deviation to expect of a parameter or family, SI."""
        return self.spec.tolerance[self.catalogue.effect_of(name).name]

    def with_parameters(
        self, values: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Machine:
        """The same machine with parameters set, SI; structured members set those they stand for,
        and what several say of one is added.

        The covariance of a calibrated machine is about other values and is left behind: what is
        then known of its parameters are their standard deviations alone.

        Args:
            values: such as ``{"joint_offset.x": 1e-3, "axis_tilt.cyclic": 2e-3}``.
            sigmas: standard deviations of some of them; 0 (known) where not given.

        Raises:
            InputError: for a name that is no parameter of the machine or one campaign's, a value
                that is no number or must be in another unit, and a standard deviation that is none
                or of another parameter.
        """
        check_magnitudes(self.spec, values)
        return self._with_entries(dict(self.spec.parameters), values, sigmas or {})

    def with_only(
        self, values: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Machine:
        """The same machine with these parameters and no others; arguments as for
        :meth:`with_parameters`.
        """
        return self._with_entries({}, values, sigmas or {})

    def with_posterior(self, values: Mapping[str, float], posterior: Posterior) -> Machine:
        """The same machine with these parameters and no others, and what is known of them.

        Args:
            values: elementary parameters, SI.
            posterior: of them and others about these values, 0 where there is none.

        Raises:
            InputError: for a name that is no single parameter of the machine.
        """
        for name in posterior.names:
            if name not in self.catalogue.motions:
                raise InputError(f"the covariance names {name!r}, which is no single parameter")
        return self._with_entries({}, values, posterior.sigmas, posterior.recentred(values))

    def with_provenance(self, provenance: Mapping[str, Any]) -> Machine:
        """The same machine, with where its parameters come from."""
        return self._with_shared_model(replace(self.spec, provenance=dict(provenance)))

    def _with_entries(
        self,
        entries: dict[str, ParameterValue],
        values: Mapping[str, float],
        sigmas: Mapping[str, float],
        posterior: Posterior | None = None,
    ) -> Machine:
        if posterior is None:
            check_sigmas(values, sigmas)
        given = parameter_entries(self.catalogue, values, sigmas)
        made = replace(self.spec, parameters=entries | given, posterior=posterior, warnings=())
        return self._with_shared_model(replace(made, file="", sha256=""))

    def _with_shared_model(self, spec: MachineFile) -> Machine:
        """A machine of the same tree, which shares what is costly to build."""
        machine = Machine(spec)
        machine.__dict__["_models"] = self._models
        return machine

    @cached_property
    def _models(self) -> list[Model]:
        """The model of all machines of this tree, once one of them has asked for it."""
        return []

    @cached_property
    def model(self) -> Model:
        """The general mechanism with this machine's dimensions."""
        if not self._models:
            spec = self.spec
            elastic, known = spec.stiffness, spec.catalogue
            built = Model(
                spec.geometry, spec.screw_pitch, stiffness=elastic, catalogue=known, urdf=spec.urdf
            )
            self._models.append(built)
        return self._models[0]

    def by_pinocchio(self) -> Machine:
        """Return the same machine with every posture closed by Pinocchio itself, which is slow."""
        machine = Machine(self.spec)
        machine.__dict__["_models"] = [self.model.by_pinocchio()]
        return machine

    @cached_property
    def _theta(self) -> Array:
        """All parameters of the machine as the model takes them."""
        return self.model.parameter_vector(self.values)

    def pose(self, rho: ArrayLike, **seen: ArrayLike) -> Pose:
        """Pose of the platform.

        Args:
            rho: commands ``(..., 3)``, metres (2008, eq. 2).
            seen: conditions where they matter: ``approach (..., 3)``, +1, -1, or 0 where it is
                unknown, the middle of the dead band; ``time``, ``warming``, ``load (...)``.

        Raises:
            ClosureError: where a posture does not close.
            InputError: for commands or conditions that are not numbers or have the wrong shape,
                or commands so large that they must be millimetres.
        """
        commands = self.geometry.commands(rho)
        out, shape = self._outputs(commands, seen), commands.shape[:-1]
        return Pose(out.p.reshape(*shape, 3), out.R.reshape(*shape, 3, 3))

    def _outputs(self, commands: Array, seen: Mapping[str, ArrayLike]) -> Outputs:
        """What closed postures show, one row a command."""
        try:
            return self.model.outputs_of_vector(
                self._theta, Conditions.from_commands(commands, **seen)
            )
        except ClosureError as error:
            error.index = batch_index(commands.shape[:-1], error.index)
            raise

    def close(self, rho: ArrayLike, **seen: ArrayLike) -> Posture:
        """Close one posture in Pinocchio, with every passive joint, errors of the parts included.

        Args:
            rho: command ``(3,)``, metres.
            seen: conditions as for :meth:`pose`.

        Raises:
            ClosureError: where the posture does not close, with the residual by loop.
        """
        command = self.geometry.commands(rho)
        if command.shape != (3,):
            raise InputError(f"close takes one command of shape (3,), not {command.shape}")
        moves = self.model.loaded_displacements(
            self.values, Conditions.from_commands(command, **seen)
        )
        return self.model.mechanism.close(command, moves.reshape(3, -1))

    def posed(self, rho: ArrayLike | None = None) -> Posed:
        """Return the machine as drawings show it, at a command ``(3,)`` or mechanical zero."""
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
        **seen: ArrayLike,
    ) -> Any:
        """Show the machine, its loops closed, in Pinocchio's meshcat viewer, which is returned.

        Args:
            rho: command ``(3,)``, metres; mechanical zero where absent.
            magnify: factor by which errors are enlarged; beyond 1 the nominal machine stands beside
                them in grey.
            out: page to write, one file that needs no network; none where absent.
            open_browser: whether a browser opens at the viewer's address.
            seen: conditions as for :meth:`pose`.

        Raises:
            InputError: where meshcat is missing, or the loops do not close with errors as large.
            FileError: where ``out`` stands already.
        """
        from orthoglide.viewer import MagnifiedMachine, show, static_page

        command = self.geometry.zero if rho is None else self.geometry.commands(rho)
        machine = MagnifiedMachine(self.model, self.values, seen, magnify)
        viewer = show(machine, command, open_browser=open_browser)
        if out is not None:
            write_file(out, static_page(viewer, machine, self.spec.title), overwrite=False)
        return viewer

    def _repr_svg_(self) -> str:
        return drawing(
            self.posed(), title=f"The machine {self.spec.name}".rstrip(), standalone=True
        )

    def bar_tensions(self, rho: ArrayLike, **seen: ArrayLike) -> Array:
        """Pull in the bars ``(..., leg, bar)`` under a ``load``, newtons; arguments as for
        :meth:`pose`.
        """
        commands = self.geometry.commands(rho)
        found = self.model.tensions(self.values, Conditions.from_commands(commands, **seen))
        return found.reshape(*commands.shape[:-1], 3, 2)

    def forward(self, rho: ArrayLike, **seen: ArrayLike) -> Array:
        """TCP ``(..., 3)``, metres, for commands ``(..., 3)``; arguments as for :meth:`pose`."""
        commands = self.geometry.commands(rho)
        return self._outputs(commands, seen).p.reshape(commands.shape)

    def jacobian(self, rho: ArrayLike, **seen: ArrayLike) -> Array:
        """dp/drho ``(..., 3, 3)``: how the TCP follows the command, all errors included.

        Arguments as for :meth:`pose`.
        """
        commands = self.geometry.commands(rho)
        conditions = Conditions.from_commands(commands, **seen)
        found = self.model.jacobian(self.values, conditions)
        return found.reshape(*commands.shape[:-1], 3, 3)

    def inverse(self, p: ArrayLike, **seen: ArrayLike) -> Array:
        """Commands ``(..., 3)`` that bring the TCP to ``p`` ``(..., 3)`` given all its effects.

        What an effect does depends on the command, so the drives are corrected until the predicted
        TCP is the wanted one. Metres; ``seen`` as for :meth:`pose`.

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
            miss = goal - self.forward(rho, **seen)
            largest = np.abs(miss).max(initial=0.0)
            if largest < 1e-13:
                return rho
            rho = rho + np.linalg.solve(self.jacobian(rho, **seen), miss[..., None])[..., 0]
        if largest < 1e-11:
            return rho
        raise ClosureError("the drives do not converge on the wanted points")

    def readings(self, given: Readings) -> Array:
        """Return the readings ``(n,)`` to expect, datums apart, metres or radians."""
        return self.model.readings(self.values, given)


MachineSource = Machine | MachineFile | Geometry | str | os.PathLike[str]
"""A machine, its file as read, the path of that, or dimensions with all else as usual."""
