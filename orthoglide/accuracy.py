"""How well a machine's TCP is known over the workspace, and the errors to expect of it.

An error over the workspace has two parts. *Place* is its mean, a translation of everything: where
the machine as a whole sits, which readings on the legs cannot tell. *Shape* is what is left after
that translation; it is what a calibration improves.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orthoglide.effects import DRIVE_ENTRIES
from orthoglide.geometry import Array, Geometry
from orthoglide.machine import Machine
from orthoglide.mechanism.perfect_legs import Spheres, commands as commands_of
from orthoglide.numerals import with_sigma
from orthoglide.prediction import Conditions

GRID = 5
"""Commands along each axis of the map of the workspace."""

_SEQUENCE_STEPS = 1 / 1.2207440846 ** np.arange(1, 4)
"""Steps of a sequence that fills a cube evenly (Roberts 2018, by the root of x^4 = x + 1)."""

_DRAWS = 400
_TRANSLATION_WEIGHT = 0.01  # weight of place against shape: enough to choose between equal shapes
_GAUSS_NEWTON_STEPS = 2  # of Gauss-Newton, on a problem that is nearly linear


def workspace_grid(geometry: Geometry, count: int = GRID, pitch: float | None = None) -> Array:
    """Return commands ``(n, 3)`` that fill the workspace evenly, metres: on the Orthoglide the
    stroke.

    Args:
        geometry: of the machine.
        count: of commands along each axis.
        pitch: of its screws, metres: commands along the stroke then stand at three phases of
            their turns, evenly, where a regular grid can meet a single one.
    """
    layout, sizes = geometry.layout, (geometry.L, geometry.r, geometry.stroke)
    if (points := layout.points(*sizes, count)) is not None:
        return commands_of(Spheres.of_geometry(geometry), points)
    travel, spacing = np.linspace(*geometry.stroke, count, retstep=True)
    grid = np.stack(np.meshgrid(travel, travel, travel, indexing="ij"), axis=-1).reshape(-1, 3)
    third = min(pitch or 0.0, float(spacing)) / 3
    phase = np.floor(3 * ((0.5 + np.arange(len(grid))[:, None] * _SEQUENCE_STEPS) % 1.0))
    low, high = (np.abs(grid - end) < third for end in (travel[0], travel[-1]))
    return np.asarray(geometry.zero[0] + grid + third * (phase - 1 + low - high))


def workspace_commands(machine: Machine) -> Array:
    """Return commands over the workspace ``(n, 3)`` at every phase of the screws, metres."""
    return workspace_grid(machine.geometry, pitch=machine.spec.screw_pitch)


def tcp_slopes(machine: Machine, names: Sequence[str], at: Conditions | None = None) -> Array:
    """Return derivatives of the TCP by parameter ``(g, 3, P)``, SI, in given conditions or over the
    workspace.
    """
    where = Conditions.from_commands(workspace_commands(machine)) if at is None else at
    _, slopes = machine.model.sensitivities(machine.values, where, tuple(names))
    return slopes[:, :3]


def without_translation(field: Array) -> Array:
    """Return a field over the workspace ``(g, 3, ...)`` after its best translation."""
    return field - field.mean(axis=0)


@dataclass(frozen=True, repr=False)
class TcpMap:
    """The predicted TCP over a set of commands."""

    commands: Array  # (g, 3), metres
    nominal: Array  # TCP of the machine without errors (g, 3)
    p: Array  # TCP of the calibrated machine (g, 3)
    sigma: Array  # standard deviation of each coordinate (g, 3), best translation removed

    @property
    def error(self) -> Array:
        """Distance of the calibrated TCP from the nominal ``(g,)``, best translation removed."""
        return np.linalg.norm(without_translation(self.p - self.nominal), axis=1)

    @property
    def uncertainty(self) -> Array:
        """95 % radius, each coordinate's taken together ``(g,)``."""
        return 1.96 * np.linalg.norm(self.sigma, axis=1)


def tcp_map(machine: Machine, commands: Array | None = None) -> TcpMap:
    """Return the predicted TCP of a calibrated machine over the workspace, with its uncertainty.

    Args:
        machine: calibrated.
        commands: ``(g, 3)``; :func:`workspace_commands` the workspace where absent.
    """
    where = workspace_commands(machine) if commands is None else commands
    posterior = machine.posterior
    slopes = without_translation(
        tcp_slopes(machine, posterior.names, Conditions.from_commands(where))
    )
    variance = np.einsum("gip,pq,giq->gi", slopes, posterior.covariance, slopes)
    nominal = machine.with_only({}).forward(where)
    return TcpMap(where, nominal, machine.forward(where), np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True)
class ExpectedError:
    """Mean distance of the TCP from where it is wanted over the workspace, metres."""

    shape: float  # after the best translation
    shape_sigma: float  # standard deviation of that
    place: float  # length of the translation
    place_sigma: float  # standard deviation of that

    def as_dict(self) -> dict[str, float]:
        """For JSON, millimetres."""
        return {f"{name}_mm": float(f"{v * 1e3:.6g}") for name, v in vars(self).items()}

    @property
    def words(self) -> str:
        """Shape with its standard deviation, millimetres."""
        return with_sigma(self.shape * 1e3, self.shape_sigma * 1e3)

    @property
    def place_words(self) -> str:
        """Place with its standard deviation, millimetres."""
        return with_sigma(self.place * 1e3, self.place_sigma * 1e3)


def expected_error(machine: Machine, settings: Mapping[str, float]) -> ExpectedError:
    """Return the tool's expected error if the controller corrects some parameters.

    Args:
        machine: calibrated.
        settings: parameters that the commands allow for, SI; the machine's own are compensation,
            none are a controller that knows of no error.
    """
    shape, distance = _sampled_errors(machine, settings)
    found = (shape.mean(), shape.std(), distance.mean(), distance.std())
    return ExpectedError(*map(float, found))


def expected_gain(
    machine: Machine, before: Mapping[str, float], after: Mapping[str, float]
) -> tuple[float, float]:
    """Return by how much the tool's mean shape error falls, and the standard deviation of that,
    metres.

    Args:
        machine: calibrated.
        before: parameters that the commands allow for, SI.
        after: those that they allow for instead.
    """
    gain = _sampled_errors(machine, before)[0] - _sampled_errors(machine, after)[0]
    return float(gain.mean()), float(gain.std())


def _sampled_errors(machine: Machine, settings: Mapping[str, float]) -> tuple[Array, Array]:
    """Return mean shape error and translation over the workspace ``(draws,)`` of machines drawn
    from the posterior, the same for all settings.
    """
    posterior, wanted = machine.posterior, wanted_points(machine)
    commands = machine.with_only(settings).inverse(wanted)
    mean = machine.forward(commands) - wanted
    slopes = tcp_slopes(machine, posterior.names, Conditions.from_commands(commands))
    draws = np.random.default_rng(0).standard_normal((_DRAWS, len(posterior.names)))
    errors = mean + np.einsum("gip,np->ngi", slopes, draws @ posterior.covariance_root.T)
    place = errors.mean(axis=1)
    shape = np.linalg.norm(errors - place[:, None], axis=2).mean(axis=1)
    return np.asarray(shape), np.linalg.norm(place, axis=1)


def wanted_points(machine: Machine) -> Array:
    """Return where a machine without errors puts the tool over its workspace ``(g, 3)``, metres."""
    return machine.with_only({}).forward(workspace_commands(machine))


def _with_weighted_translation(field: Array, place: Array) -> Array:
    """Return a field ``(g, 3, ...)`` with these shares ``(3,)`` of its translation."""
    return field - np.einsum("x,x...->x...", 1 - place, field.mean(axis=0))


def best_zeros(machine: Machine, also: Iterable[str] = ()) -> dict[str, float]:
    """Return the zeros that leave the least shape error, with what else the controller takes.

    Where several leave the same, they are those that leave the least place. On parallel slides
    they leave the tool where it is above its plate: no reading there tells the machine's own
    height, and zeros by what was only supposed of it would drive the tool into the plate. What the
    controller cannot take shifts the zeros that are best: they are fitted, by least
    squares over the workspace, to the machine with all its parameters.

    Args:
        machine: calibrated.
        also: what else the controller takes, as identified: ``"bar_length"``, ``"scale"`` ...

    Returns:
        Parameters that the commands allow for, SI.
    """
    held, of = {"zero", *also}, machine.catalogue.effect_of
    zeros = machine.catalogue.expand(machine.catalogue.correctable_by("zero"))
    identified = {n: v for n, v in machine.values.items() if of(n).controller in held}
    settings: dict[str, float] = {**dict.fromkeys(zeros, 0.0), **identified}
    wanted, goal, weight = wanted_points(machine), np.zeros(3), np.full(3, _TRANSLATION_WEIGHT)
    if machine.geometry.layout.hanging:
        above = machine.forward(workspace_commands(machine)) - wanted
        goal[2], weight[2] = above[:, 2].mean(), 1.0
    for _ in range(_GAUSS_NEWTON_STEPS):
        commands = machine.with_only(settings).inverse(wanted)
        left = _with_weighted_translation(machine.forward(commands) - wanted - goal, weight)
        slopes = _with_weighted_translation(
            tcp_slopes(machine, zeros, Conditions.from_commands(commands)), weight
        )
        step = np.linalg.lstsq(slopes.reshape(-1, len(zeros)), left.reshape(-1))[0]
        settings.update({n: settings[n] + float(d) for n, d in zip(zeros, step, strict=True)})
    return settings


def tool_settings(machine: Machine) -> dict[str, dict[str, float]]:
    """Return the parameters that the commands allow for, SI, by what the controller is given.

    Returns:
        ``now``: nothing; ``zeros``: the best zeros alone; ``zeros_and_lengths``: bar lengths
        besides; ``numbers``: all that a controller takes, with the best zeros; ``compensated``:
        everything. :func:`expected_error` says what each leaves.
    """
    return {
        "now": {},
        "zeros": best_zeros(machine),
        "zeros_and_lengths": best_zeros(machine, ["bar_length"]),
        "numbers": best_zeros(machine, DRIVE_ENTRIES),
        "compensated": machine.values,
    }
