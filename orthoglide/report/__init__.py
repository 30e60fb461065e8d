"""What a run leaves behind: result.json, calibrated.toml, residuals.csv, figures and a report."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from orthoglide.progress import Progress, Step, silent
from orthoglide.report.run import InputFile, Run, read_input

if TYPE_CHECKING:
    from orthoglide.closing import Verdict
    from orthoglide.fit import Estimate
    from orthoglide.report.verdict_view import View

__all__ = [
    "InputFile",
    "Run",
    "identification_files",
    "read_input",
    "result_text",
    "verdict_files",
    "write_verdict",
]


Files = dict[str, str | bytes]


def identification_files(estimate: Estimate, run: Run) -> Files:
    """All files of an identification's folder, by name: text, in the order to write them.

    Nothing in them depends on when or where they are made.

    Args:
        estimate: what was found.
        run: what was asked, and of which files.
    """
    from orthoglide.machine_file import machine_files
    from orthoglide.report.figures import draw
    from orthoglide.report.html import identification_page
    from orthoglide.report.result import (
        calibrated_machine,
        identification_result,
        residual_table,
        to_json,
    )

    drawings = draw(estimate)
    return {
        **machine_files(calibrated_machine(estimate, run), "calibrated.toml"),
        "residuals.csv": residual_table(estimate),
        **{f"figures/{d.name}.svg": d.svg for d in drawings},
        "report.html": identification_page(estimate, run, drawings),
        "result.json": to_json(identification_result(estimate, run)),
    }


def result_text(view: View, run: Run) -> str:
    """The text of a closed loop's ``result.json``.

    Args:
        view: of the verdict.
        run: what was asked, and of which files.
    """
    from orthoglide.report.result import to_json
    from orthoglide.report.verdict_result import verdict_result

    return to_json(verdict_result(view, run))


def verdict_files(view: View, run: Run, progress: Progress = silent) -> Files:
    """All files of a closed loop's folder, by name: text, in the order to write them.

    Nothing in them depends on when or where they are made.

    Args:
        view: of the verdict.
        run: what was asked, and of which files.
        progress: called with each step.
    """
    from orthoglide.machine_file import machine_files
    from orthoglide.report.verdict_figures import draw_verdict
    from orthoglide.report.verdict_html import verdict_page
    from orthoglide.report.verdict_result import calibrated_machine, next_table, residual_table

    verdict = view.verdict
    progress(Step("suggesting"))
    sheet = next_table(view)
    result = result_text(view, run)
    progress(Step("drawing"))
    drawings = draw_verdict(view)
    progress(Step("writing"))
    return {
        **machine_files(calibrated_machine(verdict, run), "calibrated.toml"),
        "residuals.csv": residual_table(verdict),
        **({"next_measurements.csv": sheet} if sheet else {}),
        **{f"figures/{d.name}.svg": d.svg for d in drawings},
        "report.html": verdict_page(view, run, drawings, sheet),
        "result.json": result,
    }


def write_verdict(verdict: Verdict, folder: str | os.PathLike[str]) -> None:
    """Write a verdict's report into a new folder, as the command line does.

    Args:
        verdict: what was found.
        folder: new or empty.

    Raises:
        FileError: where the folder exists and is not empty, or cannot be written.
    """
    from orthoglide.report.folder import check_folder, write_folder
    from orthoglide.report.verdict_run import run_of
    from orthoglide.report.verdict_view import View

    out = Path(folder)
    check_folder(out)
    write_folder(out, verdict_files(View(verdict), run_of(verdict)))
