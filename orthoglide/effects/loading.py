"""A user's own effects, from a Python file."""

from __future__ import annotations

import os
import runpy
from pathlib import Path

from orthoglide.effects.effect import Effect
from orthoglide.errors import FileError
from orthoglide.text import shown


def load_effects(path: str | os.PathLike[str] | None) -> tuple[Effect, ...]:
    """Effects that a Python file declares at its top level, in their order; none without a file.

    The file is run: give only files that you trust.

    Raises:
        FileError: where it is missing, fails, or declares none.
    """
    if path is None:
        return ()
    if not Path(path).is_file():
        raise FileError("there is no such file: check the name", file=shown(path))
    try:
        names = runpy.run_path(os.fspath(path))
    except SyntaxError as error:
        raise FileError(
            f"is not Python ({error.msg}): correct it", file=shown(path), line=error.lineno
        ) from None
    except (Exception, SystemExit) as error:
        raise FileError(f"fails with {type(error).__name__}: {error}", file=shown(path)) from error
    found = [value for value in names.values() if isinstance(value, Effect)]
    if not found:
        raise FileError("declares no Effect at its top level: add one", file=shown(path))
    return tuple(dict.fromkeys(found))
