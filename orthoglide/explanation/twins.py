"""What readings and tool cannot tell apart, and what moves the machine as a whole."""

from __future__ import annotations

import numpy as np

from orthoglide.accuracy import tcp_slopes
from orthoglide.fit import Problem
from orthoglide.geometry import Array
from orthoglide.parameters import Parameter
from orthoglide.prediction import Conditions

_REPLACED_TOLERANCES = 3.0
"""Tolerances of a parameter that another may replace if no reading and no tool shows it."""

_TRANSLATION_LIMIT = 1e-6  # metres: what changes the shape by less moves the machine as a whole


def tool_slopes(problem: Problem, x: Array, commands: Array | None = None) -> Array:
    """TCP of the last campaign's machine by unknown ``(g, 3, P)``, SI: at some commands ``(g, 3)``,
    metres, or throughout the workspace.
    """
    machine, last = problem.machine, problem.last_factor
    names, matrix = problem.machine_parameters(last)
    values = machine.catalogue.machine_values(problem.values(last, x))
    at = None if commands is None else Conditions.from_commands(commands)
    return tcp_slopes(machine.with_only(values), names, at) @ matrix


def translations(slopes: Array) -> Array:
    """Orthonormal directions ``(P, 3)`` of the parameters that move the machine as a whole.

    Args:
        slopes: TCP by parameter over the workspace, in tolerances ``(g, 3, P)``, metres.
    """
    mean = slopes.mean(axis=0)
    shape = (slopes - mean).reshape(-1, slopes.shape[2]) / np.sqrt(len(slopes)) / _TRANSLATION_LIMIT
    directions = np.linalg.solve(np.eye(shape.shape[1]) + shape.T @ shape, mean.T)
    return np.asarray(np.linalg.qr(directions)[0])


def twins(
    wide: Problem, free: int, columns: Array, slopes: Array
) -> dict[Parameter, tuple[tuple[Parameter, float], ...]]:
    """Parameters of which a few tolerances show the same as those of an earlier one, readings and
    tool alike: they are one cause.

    Args:
        wide: its unknowns ``P``; those of dials are no twins.
        free: the first so many are free already and stay.
        columns: readings ``(m, P)``, whitened, in tolerances.
        slopes: of the TCP ``(g, 3, P)``, in tolerances, metres.
    """
    names, noise = wide.names, wide.noise.typical
    of_dial = wide.machine.catalogue.effect_of
    # What campaigns have for themselves is one parameter here, by the sum of its copies.
    copies: dict[Parameter, list[int]] = {}
    for k, name in enumerate(names):
        if not of_dial(name).of_dial:
            copies.setdefault(name.plain, []).append(k)
    plain = list(copies)
    shown = np.stack([columns[:, at].sum(axis=1) for at in copies.values()], axis=1)
    tool = np.stack([slopes[:, :, at].sum(axis=2).ravel() for at in copies.values()], axis=1)
    tool /= np.sqrt(len(slopes))
    length = np.linalg.norm(shown, axis=0)
    unit = shown / np.where(length > 0, length, 1.0)
    cosine = unit.T @ unit
    found: dict[Parameter, tuple[tuple[Parameter, float], ...]] = {}
    gone: set[int] = set()
    for one in range(len(plain)):
        for other in range(one + 1, len(plain)):
            if {one, other} & gone or not length[one] or not length[other]:
                continue
            if min(copies[plain[other]]) < free:
                continue
            factor = float(cosine[one, other]) * length[other] / length[one]
            if abs(cosine[one, other]) < 0.99 or abs(factor) < _TRANSLATION_LIMIT:
                continue
            apart = np.linalg.norm(shown[:, other] - factor * shown[:, one])
            moved = np.linalg.norm(tool[:, other] - factor * tool[:, one])
            if _REPLACED_TOLERANCES * apart < 1.0 and _REPLACED_TOLERANCES * moved < noise / 2:
                gone.add(other)
                twin = plain[other]
                for name in (plain[one], *(names[k] for k in copies[plain[one]])):
                    stands = (twin.at(name.campaign), 1 / factor)
                    found[name] = tuple(dict.fromkeys((*found.get(name, ()), stands)))
    return found
