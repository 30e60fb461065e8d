"""The one way by which commands write: not after they were asked to stop."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from orthoglide.cli.run import stop_if_asked


def write_file(path: Path, text: str) -> None:
    """A new file, whole; `FileError` where one stands already or none can be written."""
    from orthoglide.files import write_whole

    stop_if_asked()
    write_whole(path, text, overwrite=False)


def write_results(out: Path, files: Mapping[str, str | bytes]) -> None:
    """A new folder, whole; `FileError` where it cannot be written."""
    from orthoglide.report.folder import write_folder

    stop_if_asked()
    write_folder(out, files)
