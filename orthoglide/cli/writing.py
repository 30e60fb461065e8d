"""The one way by which commands write: not after they were asked to stop, and then for good."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orthoglide.cli.run import committing, stop_if_asked
from orthoglide.text import shown

if TYPE_CHECKING:
    from orthoglide.machine import Machine
    from orthoglide.observations import Readings


def next_free(path: Path) -> Path:
    """The path, numbered where earlier results stand."""
    free, number = path, 1
    while free.exists() and (not free.is_dir() or any(free.iterdir())):
        number += 1
        free = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return free


def write_texts(texts: Mapping[Path, str]) -> None:
    """New files, all of them whole or none; `FileError` where one stands or cannot be written."""
    from orthoglide.files import write_files

    stop_if_asked()
    write_files(texts, commit=committing)


def write_sheet(path: Path, sheet: Readings, machine: Machine) -> str:
    """A new measuring sheet in the coordinates of the machine's controller, and the page to print
    beside it; what they hold.
    """
    from orthoglide.observations import campaign_text
    from orthoglide.report.sheet import sheet_page

    page = path.with_suffix(".html")
    page = page if page != path else path.with_name(path.name + ".html")
    told = (
        f"{click.format_filename(path)}: {len(sheet)} readings in {len(sheet.setups)} setups, to "
        f"be filled in as reading_mm; {len(sheet.moves)} rows are moves: go there, read nothing\n"
        f"{click.format_filename(page)}: the same rows to print and carry to the machine"
    )
    shown_as = shown(path.name)
    texts = {path: campaign_text(sheet, machine.spec), page: sheet_page(sheet, machine, shown_as)}
    write_texts(texts)
    return told


def write_results(out: Path, files: Mapping[str, str | bytes]) -> None:
    """A new folder, whole; `FileError` where it cannot be written."""
    from orthoglide.report.folder import write_folder

    stop_if_asked()
    write_folder(out, files, commit=committing)
