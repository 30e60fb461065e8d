"""The output folder: it is written whole or not at all, and replaces only an earlier report."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from orthoglide.errors import FileError
from orthoglide.files import as_file_errors, temporary_path

_REPORT_FILES = {
    "calibrated.npz", "calibrated.toml", "figures", "next_measurements.csv",
    "next_measurements.html", "report.html", "residuals.csv", "result.json",
}  # fmt: skip
"""Names in a report's folder: a folder that contains any other name is not replaced."""


def check_folder(out: Path, overwrite: bool = False) -> Path:
    """Return the resolved folder for results, or raise an error before any work is done.

    Args:
        out: the folder; new or empty.
        overwrite: whether it may contain an earlier report, and nothing else.

    Raises:
        FileError: if results cannot be written there.
    """
    with as_file_errors(out):
        target = Path(os.path.realpath(out))
        names = {path.name for path in target.iterdir()} if target.is_dir() else set()
        foreign, parent = sorted(names - _REPORT_FILES), target.parent
        problems = {
            "is a link to nothing: name a new folder": out.is_symlink() and not target.exists(),
            "is a file: name a new folder for the results": target.exists() and not target.is_dir(),
            "is the folder you are in: name a new one inside it": target == Path.cwd(),
            "is not empty and results are never overwritten: name a new or empty folder":
                names and not overwrite,
            f"must hold an earlier report alone, and holds {''.join(foreign[:1])}: name another":
                foreign,
            "cannot be made where there is no folder to hold it: make that first":
                not parent.is_dir(),
            "cannot be made here: choose a place you may write to":
                not os.access(parent, os.W_OK | os.X_OK),
        }  # fmt: skip
    if problem := next((words for words, applies in problems.items() if applies), ""):
        raise FileError(problem, file=out)
    return target


def write_folder(out: Path, files: Mapping[str, str | bytes], overwrite: bool = False) -> None:
    """Write files into a temporary sibling, then rename it.

    Args:
        out: the folder; new or empty, or an earlier report.
        files: content by name, ``/`` for folders inside; written in this order, text as UTF-8.
        overwrite: whether an earlier report is replaced whole.

    Raises:
        FileError: if the folder cannot be written.
    """
    target = check_folder(out, overwrite)
    with as_file_errors(out):
        temporary = temporary_path(target)
        try:
            temporary.mkdir()
            for name, content in files.items():
                if ".." in Path(name).parts or Path(name).is_absolute():
                    raise FileError("must be a place within the folder", file=name)
                path = temporary / name
                path.parent.mkdir(exist_ok=True)
                path.write_bytes(content.encode() if isinstance(content, str) else content)
            _move_into_place(temporary, target, overwrite)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise


def _move_into_place(temporary: Path, target: Path, overwrite: bool) -> None:
    """Rename a folder to a name that may exist; the earlier folder is removed only afterwards.

    The system refuses to replace a folder that another process has just filled.
    """
    earlier = temporary.with_name(f"{temporary.name}-earlier")
    if overwrite and target.is_dir() and any(target.iterdir()):
        target.rename(earlier)
    try:
        temporary.rename(target)
    except BaseException:
        if earlier.exists():
            earlier.rename(target)
        raise
    shutil.rmtree(earlier, ignore_errors=True)
