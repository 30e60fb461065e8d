"""The output folder: it appears whole or not at all, and never over something else."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import NoReturn

from orthoglide.errors import FileError
from orthoglide.files import as_file_errors, temporary_path
from orthoglide.text import printable_path

_REPORT_FILES = {
    "calibrated.npz", "calibrated.toml", "figures", "next_measurements.csv",
    "next_measurements.html", "report.html", "residuals.csv", "result.json",
}  # fmt: skip
"""All that a report consists of: a folder that holds anything else is nobody's to replace."""


def check_folder(out: Path, overwrite: bool = False) -> Path:
    """Refuse a place where results cannot go, before any work is done.

    Args:
        out: the folder to be; new or empty.
        overwrite: whether it may hold an earlier report, and nothing else.

    Returns:
        The folder, resolved.

    Raises:
        FileError: saying what would do.
    """

    def refuse(why: str) -> NoReturn:
        raise FileError(why, file=printable_path(out))

    with as_file_errors(out):
        target = Path(os.path.realpath(out))
        if out.is_symlink() and not target.exists():
            refuse("is a link to nothing: name a new folder")
        if target.exists() and not target.is_dir():
            refuse("is a file: name a new folder for the results")
        if target == Path.cwd():
            refuse("is the folder you are in: name a new one inside it")
        names = {path.name for path in target.iterdir()} if target.is_dir() else set()
        if names and not overwrite:
            refuse("is not empty and results are never overwritten: name a new or empty folder")
        if names - _REPORT_FILES:
            part = sorted(names - _REPORT_FILES)[0]
            refuse(f"holds {part}, which is no part of a report: name another folder")
        if not target.parent.is_dir():
            refuse("cannot be made where there is no folder to hold it: make that first")
        if not os.access(target.parent, os.W_OK | os.X_OK):
            refuse("cannot be made here: choose a place you may write to")
    return target


def write_folder(
    out: Path,
    files: Mapping[str, str | bytes],
    overwrite: bool = False,
) -> None:
    """Write files into a temporary sibling, then rename it.

    Args:
        out: the folder; new or empty, or an earlier report.
        files: content by name, ``/`` for folders inside; written in this order, text as UTF-8.
        overwrite: whether an earlier report is replaced whole.

    Raises:
        FileError: where the folder cannot be written.
    """
    target = check_folder(out, overwrite)
    with as_file_errors(out):
        made = temporary_path(target)
        try:
            made.mkdir()
            for name, content in files.items():
                if ".." in Path(name).parts or Path(name).is_absolute():
                    raise FileError("is no place within the folder", file=printable_path(name))
                path = made / name
                path.parent.mkdir(exist_ok=True)
                path.write_bytes(content.encode() if isinstance(content, str) else content)
            _move_into_place(made, target, overwrite)
        except BaseException:
            shutil.rmtree(made, ignore_errors=True)
            raise


def _move_into_place(made: Path, target: Path, overwrite: bool) -> None:
    """Rename a folder to a name that may exist; the earlier folder is removed only afterwards.

    What another process put there a moment ago is not replaced: the system refuses to.
    """
    earlier = made.with_name(f"{made.name}-earlier")
    if overwrite and target.is_dir() and any(target.iterdir()):
        target.rename(earlier)
    try:
        made.rename(target)
    except BaseException:
        if earlier.exists():
            earlier.rename(target)
        raise
    shutil.rmtree(earlier, ignore_errors=True)
