"""Effects of a user's own: loaded from a Python file, and checked before they are needed."""

from __future__ import annotations

import os
import runpy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orthoglide.effects.effect import DialReading, Effect, LegConditions
from orthoglide.errors import FileError, InputError

_ARITHMETIC = (
    "write it with + - * / ** and with sin and cos of orthoglide.effects, without math, or if "
    "and loops over conditions"
)
_NO_TRAVEL = (
    "a motion of travel cannot look at c.travel or c.u, which follow from it: use c.command or "
    "c.nominal_travel"
)
_NO_PITCH = "c.pitch is None where the machine file has none: return 0.0 then"

# Travel, approach, time, warming and force in the middle and toward both ends; then bar length,
# stroke, command at zero and pitch, which are symbols too: one function serves all dimensions.
_SAMPLE_DIMENSIONS = (0.3, -0.1, 0.06, 0.3, 0.02)
_SAMPLE_CONDITIONS = (
    (-0.08, -1, 0, 0, -5, *_SAMPLE_DIMENSIONS),
    (0, 0, 0, 0, 0, *_SAMPLE_DIMENSIONS),
    (0.05, 1, 3600, 5, 10, *_SAMPLE_DIMENSIONS),
)


def check_bases(effect: Effect) -> None:
    """Evaluate the functions of an effect as the mechanism will.

    Raises:
        InputError: naming the parameter and the remedy, where a function fails on symbols or
            returns no finite number.
    """
    import casadi as ca

    symbols = ca.SX.sym("conditions", len(_SAMPLE_CONDITIONS[0]))
    parts: list[Any] = ca.vertsplit(symbols)
    travel, approach, time, warming, force, length, low, high, zero, pitch = parts
    command = travel + zero
    conditions = LegConditions(
        command, length, (low, high), pitch, approach, time, warming, force, travel, zero,
        (command,) * 3,
    )  # fmt: skip
    if (dial := effect.dial) is not None:
        reading = DialReading(travel, approach, time)
        _check_basis(effect.name, symbols, lambda: dial(reading, 1e-3), _ARITHMETIC)
    for name, (_, motions) in effect.motions.items():
        for motion in motions:
            of_drive = motion.joint == "travel"
            known = replace(conditions, travel=None) if of_drive else conditions
            for given, remedy in (
                (conditions, _ARITHMETIC),
                (known, _NO_TRAVEL),
                (replace(known, pitch=None), _NO_PITCH),
            ):
                _check_basis(name, symbols, partial(motion.basis, given), remedy)


def _check_basis(name: str, symbols: Any, basis: Callable[[], Any], remedy: str) -> None:
    import casadi as ca

    try:
        value = basis()
        problem = "" if np.isscalar(value) or isinstance(value, ca.SX) else f"gives {value!r}"
        if not problem:
            function = ca.Function("basis", [symbols], [value])
            results = np.array(function(np.transpose(_SAMPLE_CONDITIONS)))
            problem = "" if np.isfinite(results).all() else "gives no finite number"
    except Exception as error:  # whatever a user's function raises
        problem = f"fails on symbols ({type(error).__name__}: {error})"
    if problem:
        raise InputError(f"{name}: its basis {problem.splitlines()[0]}: {remedy}")


def load_effects(path: str | os.PathLike[str] | None) -> tuple[Effect, ...]:
    """Return the effects that a Python file declares at its top level; none without a file.

    The file is run: give only files that you trust.

    Raises:
        FileError: where it is missing, fails, or declares none.
    """
    if path is None:
        return ()
    if not Path(path).is_file():
        raise FileError("there is no such file: check the name", file=path)
    try:
        variables = runpy.run_path(os.fspath(path))
    except SyntaxError as error:
        raise FileError(
            f"is not Python ({error.msg}): correct it", file=path, line=error.lineno
        ) from None
    except (Exception, SystemExit) as error:
        raise FileError(f"fails with {type(error).__name__}: {error}", file=path) from error
    effects = [value for value in variables.values() if isinstance(value, Effect)]
    if not effects:
        raise FileError("declares no Effect at its top level: add one", file=path)
    return tuple(dict.fromkeys(effects))
