"""What a run leaves behind: result.json, calibrated.toml, residuals.csv, figures and a report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orthoglide.report.run import InputFile, Run, read_input

if TYPE_CHECKING:
    from orthoglide.identification import Estimate

__all__ = ["InputFile", "Run", "identification_files", "read_input"]


def identification_files(estimate: Estimate, run: Run) -> dict[str, str]:
    """All files of an identification's folder, by name: text, in the order to write them.

    Nothing in them depends on when or where they are made.

    Args:
        estimate: what was found.
        run: what was asked, and of which files.
    """
    from orthoglide.machine_file import machine_text
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
        "calibrated.toml": machine_text(calibrated_machine(estimate, run), "calibrated.toml"),
        "residuals.csv": residual_table(estimate),
        **{f"figures/{d.name}.svg": d.svg for d in drawings},
        "report.html": identification_page(estimate, run, drawings),
        "result.json": to_json(identification_result(estimate, run)),
    }
