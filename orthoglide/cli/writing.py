"""The one way by which commands write: not after they were asked to stop."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orthoglide.cli.run import stop_if_asked

if TYPE_CHECKING:
    from orthoglide.machine import Machine
    from orthoglide.observations import Campaign


def write_file(path: Path, text: str) -> None:
    """A new file, whole; `FileError` where one stands already or none can be written."""
    from orthoglide.files import write_whole

    stop_if_asked()
    write_whole(path, text, overwrite=False)


def write_sheet(path: Path, sheet: Campaign, machine: Machine) -> str:
    """A new measuring sheet, in the coordinates of the machine's controller; and what it holds."""
    from orthoglide.observations import campaign_text

    write_file(path, campaign_text(sheet, machine.spec))
    return (
        f"{click.format_filename(path)}: {len(sheet)} readings in {len(sheet.setups)} setups, to "
        f"be filled in as reading_mm; {len(sheet.moves)} rows are moves: go there, read nothing"
    )


def write_results(out: Path, files: Mapping[str, str | bytes]) -> None:
    """A new folder, whole; `FileError` where it cannot be written."""
    from orthoglide.report.folder import write_folder

    stop_if_asked()
    write_folder(out, files)
