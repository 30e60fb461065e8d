"""Effects of one's own from a Python file: every `Effect` that the file declares."""

from __future__ import annotations

import os
import runpy
from pathlib import Path

from orthoglide.effects.effect import Effect
from orthoglide.errors import FileError, InputError


def read_effects(path: str | os.PathLike[str]) -> tuple[Effect, ...]:
    """Run a Python file and take the effects that stand in it under a name, in their order.

    The file is run as it stands: read only what you trust.

    Args:
        path: the file.

    Raises:
        FileError: where there is no such file, it cannot be run, or declares no effect.
    """
    if not Path(path).is_file():
        raise FileError("there is no such file: check the name", file=str(path))
    try:
        found = runpy.run_path(str(path))
    except InputError as error:  # of an effect
        raise FileError(str(error), file=str(path)) from error
    except Exception as error:
        raise FileError(
            f"cannot be run as Python ({type(error).__name__}: {error}): correct it", file=str(path)
        ) from error
    effects = tuple(value for value in found.values() if isinstance(value, Effect))
    if not effects:
        raise FileError(
            "declares no effect: assign an orthoglide.effects.Effect to a name in it",
            file=str(path),
        )
    return tuple(dict.fromkeys(effects))
