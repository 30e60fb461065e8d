"""The TCP over the workspace: its uncertainty, and the errors to expect.

An error over the workspace has two parts. The *common offset* (``place``) is its mean, a
translation, which readings on the legs cannot detect. The *shape error* (``shape``) is the error
after that translation is removed; a calibration improves it.
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

_DRAWS = 400  # machines drawn from the posterior
_TRANSLATION_WEIGHT = 0.01  # weight of the common offset: it decides between equal shape errors
_GAUSS_NEWTON_STEPS = 2  # enough for a problem that is nearly linear
MIN_SIGMAS = 2.0  # standard deviations by which an expected gain must exceed zero


def workspace_grid(geometry: Geometry, count: int = GRID, pitch: float | None = None) -> Array:
    """Return commands ``(n, 3)`` that fill the workspace evenly, metres, ``count`` along each axis.

    With the ``pitch`` of screws, metres, commands are shifted to three equally frequent phases of a
    turn, where a regular grid may meet only one.
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
    """Return derivatives of the TCP by parameter ``(g, 3, P)``, SI, in conditions ``at`` or over
    the workspace.
    """
    conditions = Conditions.from_commands(workspace_commands(machine)) if at is None else at
    _, slopes = machine.model.sensitivities(machine.values, conditions, tuple(names))
    return slopes[:, :3]


def output_sigmas(machine: Machine, slopes: Array) -> Array:
    """Return standard deviations ``(...)`` of outputs by their derivatives ``(..., P)`` by the
    parameters of the machine's posterior.
    """
    variance = np.einsum("...p,pq,...q->...", slopes, machine.posterior.covariance, slopes)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def without_translation(field: Array) -> Array:
    """Return a field over the workspace ``(g, 3, ...)`` minus its mean, the best translation."""
    return field - field.mean(axis=0)


@dataclass(frozen=True, repr=False)
class TcpMap:
    """The predicted TCP over a set of commands."""

    commands: Array  # (g, 3), metres
    nominal: Array  # TCP of the machine without errors (g, 3)
    p: Array  # TCP of the calibrated machine (g, 3)
    sigma: Array  # standard deviation of every coordinate (g, 3), best translation removed

    @property
    def uncertainty(self) -> Array:
        """95 % radius from the standard deviations of all coordinates ``(g,)``."""
        return 1.96 * np.linalg.norm(self.sigma, axis=1)


def tcp_map(machine: Machine, commands: Array | None = None) -> TcpMap:
    """Return the predicted TCP of a calibrated machine, with its uncertainty, over the workspace or
    at commands ``(g, 3)``, metres.
    """
    grid = workspace_commands(machine) if commands is None else commands
    slopes = tcp_slopes(machine, machine.posterior.names, Conditions.from_commands(grid))
    sigma = output_sigmas(machine, without_translation(slopes))
    return TcpMap(grid, machine.with_only({}).forward(grid), machine.forward(grid), sigma)


@dataclass(frozen=True)
class ExpectedError:
    """Mean distance of the TCP from the commanded position over the workspace, metres."""

    shape: float  # mean after the best translation is removed
    shape_sigma: float  # standard deviation of `shape`
    place: float  # length of the best translation
    place_sigma: float  # standard deviation of `place`

    def as_dict(self) -> dict[str, float]:
        """Return the fields for JSON, millimetres."""
        return {f"{name}_mm": float(f"{v * 1e3:.6g}") for name, v in vars(self).items()}

    @property
    def words(self) -> str:
        """Shape error with its standard deviation, millimetres."""
        return with_sigma(self.shape * 1e3, self.shape_sigma * 1e3)

    @property
    def place_words(self) -> str:
        """Common offset with its standard deviation, millimetres."""
        return with_sigma(self.place * 1e3, self.place_sigma * 1e3)


def expected_error(machine: Machine, settings: Mapping[str, float]) -> ExpectedError:
    """Return the expected error of a calibrated machine if its commands allow for some parameters,
    SI: for all its values if they are compensated, for none without corrections.
    """
    shape, offset = _sampled_errors(machine, settings)
    return ExpectedError(*map(float, (shape.mean(), shape.std(), offset.mean(), offset.std())))


def expected_gain(
    machine: Machine, before: Mapping[str, float], after: Mapping[str, float]
) -> tuple[float, float]:
    """Return the decrease of the mean shape error of a calibrated machine and its standard
    deviation, metres, by the parameters that the commands allow for before and after, SI.
    """
    gain = _sampled_errors(machine, before)[0] - _sampled_errors(machine, after)[0]
    return float(gain.mean()), float(gain.std())


def lack_of_gain(gain: float, sigma: float) -> str:
    """Return why a correction is not advised, a clause; empty if its expected gain is certain.

    Compensated commands, sizes in a controller, and new numbers of a firmware must all meet this
    rule. The last two must also not be expected to raise the error in height or along the plate by
    more than its sigma (`control.delta_numbers.Gain.lack`).

    Args:
        gain: expected decrease of the tool's error, metres.
        sigma: its standard deviation.
    """
    if gain > MIN_SIGMAS * sigma:
        return ""
    size = with_sigma(gain * 1e3, sigma * 1e3)
    return f"the expected gain, {size} mm, is below two standard deviations"


def _sampled_errors(machine: Machine, settings: Mapping[str, float]) -> tuple[Array, Array]:
    """Return the mean shape error and the common offset ``(draws,)`` of machines drawn from the
    posterior; all settings use the same draws.
    """
    wanted = wanted_points(machine)
    errors = drawn_errors(machine, machine.with_only(settings).inverse(wanted), wanted)
    translation = errors.mean(axis=1)
    shape = np.linalg.norm(errors - translation[:, None], axis=2).mean(axis=1)
    return np.asarray(shape), np.linalg.norm(translation, axis=1)


def drawn_errors(machine: Machine, commands: Array, wanted: Array) -> Array:
    """Return errors of the tool ``(draws, g, 3)`` at commands for wanted points ``(g, 3)``, metres,
    of machines drawn from the posterior; the draws are always the same.
    """
    posterior, mean = machine.posterior, machine.forward(commands) - wanted
    slopes = tcp_slopes(machine, posterior.names, Conditions.from_commands(commands))
    draws = np.random.default_rng(0).standard_normal((_DRAWS, len(posterior.names)))
    return np.asarray(mean + np.einsum("gip,np->ngi", slopes, draws @ posterior.covariance_root.T))


def wanted_points(machine: Machine) -> Array:
    """Return the positions of the tool over the workspace without errors ``(g, 3)``, metres."""
    return machine.with_only({}).forward(workspace_commands(machine))


def best_zeros(machine: Machine, also: Iterable[str] = ()) -> dict[str, float]:
    """Return the zeros with the least shape error and other entries of the controller, such as
    ``"bar_length"`` or ``"scale"``, as parameters that the commands allow for, SI.

    The zeros are fitted by least squares over the workspace to the machine with all its parameters,
    as errors that the controller cannot correct shift the best zeros. Of zeros with equal shape
    errors those with the least common offset are taken. On parallel slides the zeros keep the
    tool's height above its plate: readings there do not determine the height of the machine, and
    zeros from a prior would drive the tool into the plate.
    """
    taken, effect_of = {"zero", *also}, machine.catalogue.effect_of
    zeros = machine.catalogue.expand(machine.catalogue.correctable_by("zero"))
    identified = {n: v for n, v in machine.values.items() if effect_of(n).controller in taken}
    settings: dict[str, float] = {**dict.fromkeys(zeros, 0.0), **identified}
    wanted, goal, weight = wanted_points(machine), np.zeros(3), np.full(3, _TRANSLATION_WEIGHT)
    if machine.geometry.layout.hanging:
        above = machine.forward(workspace_commands(machine)) - wanted
        goal[2], weight[2] = above[:, 2].mean(), 1.0
    for _ in range(_GAUSS_NEWTON_STEPS):
        commands = machine.with_only(settings).inverse(wanted)
        error = machine.forward(commands) - wanted - goal
        slopes = tcp_slopes(machine, zeros, Conditions.from_commands(commands))
        error -= (1 - weight) * error.mean(axis=0)
        slopes = slopes - (1 - weight[:, None]) * slopes.mean(axis=0)
        step = np.linalg.lstsq(slopes.reshape(-1, len(zeros)), error.reshape(-1))[0]
        settings.update({n: settings[n] + float(d) for n, d in zip(zeros, step, strict=True)})
    return settings


def tool_settings(machine: Machine) -> dict[str, dict[str, float]]:
    """Return the parameters that the commands allow for, SI, at each stage of correction.

    ``now``: none; ``zeros``: the best zeros; ``zeros_and_lengths``: zeros and bar lengths;
    ``numbers``: all entries of a controller; ``compensated``: all parameters.
    """
    return {
        "now": {},
        "zeros": best_zeros(machine),
        "zeros_and_lengths": best_zeros(machine, ["bar_length"]),
        "numbers": best_zeros(machine, DRIVE_ENTRIES),
        "compensated": machine.values,
    }
