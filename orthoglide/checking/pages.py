"""What changed between two states of a machine: for the terminal, and as a page."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from orthoglide import __version__
from orthoglide.checking.comparing import Check
from orthoglide.explanation.change import COLUMNS
from orthoglide.numerals import plain
from orthoglide.progress import Progress, no_progress
from orthoglide.report import report_files
from orthoglide.report.page import Section, render_template
from orthoglide.report.sentences import headline
from orthoglide.report.terminal import action_lines
from orthoglide.text import csv_text, sentence


def changes_text(comparison: Check) -> str:
    """Return the text for the terminal: changes, remaining errors, and proofs of new zeros."""
    data = _page_data(comparison)
    parts = [f"- {text}" for text in data["said"]]
    parts += [f"- data: {fault.message}" for fault in comparison.with_changes.blunders]
    parts += ["", "The machine now:", data["left"], data["tool"]]
    parts += [f"Caution: {text}" for text in comparison.with_changes.further_cautions]
    parts += ["", "What to do:", *action_lines(comparison.with_changes)]
    advice = comparison.verdict.firmware
    withheld = any(one.kind == "zeros" for one in comparison.with_changes.withheld)
    if advice is not None and advice.corrections is not None and not withheld:
        source = "from the new readings alone"
        parts.append(f"(close-loop lists the numbers for the firmware, {source}.)")
    if data["checks"]:
        parts += ["", f"{data['zeros']}:", *(f"- {text}" for text in data["checks"])]
    return "\n".join(parts)


def check_files(comparison: Check, progress: Progress = no_progress) -> dict[str, str | bytes]:
    """Return the files of a comparison's folder by name: the report of the new state with what
    changed since the old one, and the changes as a table and a page.
    """
    result = replace(comparison.with_changes, compared=comparison.sentences)
    rows = ((d.parameter, *(c.replace("−", "-") for c in d.cells)) for d in comparison.differences)
    return {
        **report_files(result, progress),
        "changes.csv": csv_text(("parameter", *COLUMNS), rows),
        "check.html": changes_page(comparison),
    }


def changes_page(comparison: Check) -> str:
    """Return the comparison as HTML, with a drawing and a table of both states."""
    drawn = {
        "judged": ", ".join(c.name for c in comparison.verdict.request.readings),
        "sheet": False,
        "columns": COLUMNS,
        "rows": [(sentence(d.words)[:-1], d) for d in comparison.differences],
    }
    verdict = comparison.with_changes
    sections = [Section("changes", "", _page_data(comparison) | drawn, folded=False)]
    if verdict.blunders:
        sections.append(Section("faults", "Faults of the data"))
    return render_template(
        "page.html.j2",
        result=verdict,
        title="What changed on this machine",
        subtitle=f"from {', '.join(comparison.old)} to {', '.join(comparison.new)}",
        sections=sections,
        version=__version__,
        command="check",
    )


def _page_data(comparison: Check) -> dict[str, Any]:
    verdict = replace(comparison.with_changes, changed=())  # listed by parameter
    numbers = comparison.with_changes.numbers
    now, zeros = (f"{numbers.expected[k].shape * 1e3:.3f} mm" for k in ("now", "zeros"))
    zero = ", ".join(f"{d.leg} {plain(d.new_zero * 1e3, 3)}" for d in numbers.drives)
    enters_zeros = any(action.kind == "zeros" for action in verdict.actions)
    return {
        "said": [sentence(text) for text in comparison.sentences],
        "left": headline(verdict),
        "tool": f"Mean error of the tool after the best translation: {now} now"
        f"{f', {zeros} once the zeros are corrected' * enters_zeros}.",
        "zeros": f"Once new zeros are entered ({zero} mm), these readings prove their "
        f"signs, each from the new zeros with the dial set to 0 there",
        "checks": [sentence(str(check)) for check in numbers.checks] if enters_zeros else [],
    }
