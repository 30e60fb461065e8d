"""Parameters with equal effects on readings and tool, and translations of the whole machine."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from orthoglide.accuracy import tcp_slopes
from orthoglide.fit import Problem
from orthoglide.fit.problem import MAX_TOLERANCES
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter
from orthoglide.prediction import Conditions

_TRANSLATION_LIMIT = 1e-6  # metres: least change of shape of what is no translation


def tool_slopes(problem: Problem, x: Array, commands: Array | None = None) -> Array:
    """Return the Jacobian of the last campaign's TCP by unknown ``(g, 3, P)``, SI.

    It is taken at ``commands`` ``(g, 3)``, metres, or throughout the workspace.
    """
    machine, last_index = problem.machine, problem.last_factor_index
    names, matrix = problem.machine_parameters(last_index)
    values = machine.catalogue.machine_values(problem.values(last_index, x))
    conditions = None if commands is None else Conditions.from_commands(commands)
    return tcp_slopes(machine.with_only(values), names, conditions) @ matrix


def translations(slopes: Array) -> Array:
    """Return orthonormal directions ``(P, 3)`` of the parameters that translate the whole machine.

    Args:
        slopes: TCP by parameter over the workspace, in tolerances ``(g, 3, P)``, metres.
    """
    mean = slopes.mean(axis=0)
    shape_slopes = (
        (slopes - mean).reshape(-1, slopes.shape[2]) / np.sqrt(len(slopes)) / _TRANSLATION_LIMIT
    )
    penalty = np.eye(shape_slopes.shape[1]) + shape_slopes.T @ shape_slopes
    return np.asarray(np.linalg.qr(np.linalg.solve(penalty, mean.T))[0])


def twins(
    full_problem: Problem, base_count: int, columns: Array, slopes: Array
) -> dict[Parameter, tuple[tuple[Parameter, float], ...]]:
    """Return the twins of each parameter: later ones with equal effects on readings and tool.

    Each twin comes with the value that is equivalent to one unit of the parameter. Not even the
    largest plausible errors may differ by a sigma, or move the tool differently by half of one.

    Args:
        full_problem: has ``P`` unknowns; those of dials have no twins.
        base_count: number of its first unknowns, which are never replaced.
        columns: readings ``(m, P)``, whitened, in tolerances.
        slopes: of the TCP ``(g, 3, P)``, in tolerances, metres.
    """
    names, noise = full_problem.names, full_problem.noise.typical
    of_dial = full_problem.machine.catalogue.effect_of
    # The copies of a parameter that is specific to campaigns count as one, by their sum.
    copies_of: dict[Parameter, list[int]] = {}
    for k, name in enumerate(names):
        if not of_dial(name).of_dial:
            copies_of.setdefault(name.plain, []).append(k)
    plain = list(copies_of)
    shown = np.stack([columns[:, k].sum(axis=1) for k in copies_of.values()], axis=1)
    tool = np.stack([slopes[:, :, k].sum(axis=2).ravel() for k in copies_of.values()], axis=1)
    tool /= np.sqrt(len(slopes))
    length = np.linalg.norm(shown, axis=0)
    unit = shown / np.where(length > 0, length, 1.0)
    cosine = unit.T @ unit
    twins_of: dict[Parameter, tuple[tuple[Parameter, float], ...]] = {}
    replaced: set[int] = set()
    for i, j in combinations(range(len(plain)), 2):
        if {i, j} & replaced or not length[i] or not length[j]:
            continue
        factor = float(cosine[i, j]) * length[j] / length[i]
        if abs(cosine[i, j]) < 0.99 or abs(factor) < _TRANSLATION_LIMIT:
            continue
        in_readings = np.linalg.norm(shown[:, j] - factor * shown[:, i])
        in_tool = np.linalg.norm(tool[:, j] - factor * tool[:, i])
        equal = MAX_TOLERANCES * in_readings < 1.0 and MAX_TOLERANCES * in_tool < noise / 2
        if equal and min(copies_of[plain[j]]) >= base_count:
            replaced.add(j)
            for name in (plain[i], *(names[k] for k in copies_of[plain[i]])):
                twin = plain[j].at(name.campaign), 1 / factor
                twins_of[name] = tuple(dict.fromkeys((*twins_of.get(name, ()), twin)))
    return twins_of
