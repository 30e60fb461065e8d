"""What a run leaves behind: result.json, calibrated.toml, residuals.csv, figures and a report.

Everything here reads a `Result` and computes nothing of its own.
"""

from __future__ import annotations

from orthoglide.progress import Progress, Step, no_progress
from orthoglide.report.folder import result_text as result_text, write_folder as write_folder
from orthoglide.report.terminal import summary as summary
from orthoglide.result import Result


def report_files(result: Result, progress: Progress = no_progress) -> dict[str, str | bytes]:
    """Return the contents of all files of a result's folder by name, in the order to write them.

    They are the same wherever and whenever they are made.
    """
    from orthoglide.figures.draw import draw
    from orthoglide.machine_file import machine_file_contents
    from orthoglide.observations import campaign_text
    from orthoglide.report.folder import calibrated_machine, residual_table
    from orthoglide.report.page import page
    from orthoglide.report.sheet import sheet_page

    machine, sheets = result.request.machine, dict[str, str]()
    if result.next_sheet is not None:
        sheets["next_measurements.csv"] = campaign_text(result.next_sheet, machine.spec)
        page_text = sheet_page(result.next_sheet, machine, "next_measurements.csv")
        sheets["next_measurements.html"] = page_text
    text = result_text(result)
    progress(Step("drawing"))
    drawings = draw(result)
    progress(Step("writing"))
    return {
        **machine_file_contents(calibrated_machine(result), "calibrated.toml"),
        "residuals.csv": residual_table(result),
        **sheets,
        **{f"figures/{d.name}.svg": d.svg for d in drawings},
        "report.html": page(result, drawings, sheets.get("next_measurements.csv", "")),
        "result.json": text,
    }
