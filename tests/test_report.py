"""The report and what lies beside it: well formed, self-contained, the same bytes, and true."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import pytest

import orthoglide as og
from orthoglide.closing import RunOutcome, build_result, compute_outcome
from orthoglide.figures.axes import round_ticks
from orthoglide.figures.draw import draw
from orthoglide.figures.style import PALETTE
from orthoglide.fit import Estimate
from orthoglide.numerals import compact, decimals_for, plain, probability, signed, with_sigma
from orthoglide.report import report_files
from orthoglide.report.page import finding, render_template
from orthoglide.report.rows import weak_sentences
from orthoglide.report.sentences import claim_text, headline
from orthoglide.result import Request
from orthoglide.result.fits import WeakDirection
from orthoglide.verdict import Verdict

DATA = Path(og.__file__).parent / "data"
RIG = Path(__file__).parent / "data" / "rig"


def asked(
    *files: Path, machine: og.Machine | None = None, campaigns: Any = (), **options: Any
) -> Request:
    """What ``identify`` is asked of files, or of campaigns."""
    machine = machine or og.Machine.nominal()
    several = tuple(og.read_campaign(file, machine.spec) for file in files)
    return Request("identify", (*several, *campaigns), machine, **options)


@cache
def closed_of(which: str = "published") -> RunOutcome:
    one, two = (DATA / f"experiment{k}.csv" for k in (2, 3))
    if which == "rig":
        return compute_outcome(
            asked(RIG / "rig-2.csv", machine=og.Machine.load(RIG / "machine.toml"))
        )
    if which == "two":
        free, own = ("joint_offset", "axis_tilt"), ("joint_offset",)
        return compute_outcome(asked(one, two, free=free, own=own))
    return compute_outcome(asked(one))


@cache
def result_of(which: str = "published") -> Verdict:
    return build_result(closed_of(which), Verdict)


def published() -> Estimate:
    return closed_of().after


@cache
def files_of(which: str = "published") -> dict[str, str]:
    return report_files(result_of(which))


def words(html: str) -> str:
    """The text of a page, spaces made single."""
    text = re.sub(r"<(style|script|noscript)\b.*?</\1>", "", html, flags=re.DOTALL)
    text = re.sub(r"<[^>]*>", " ", text).replace("&#160;", " ").replace("&#39;", "'")
    return " ".join(text.split())


def screen(verdict: Verdict) -> str:
    """What a reader finds on the first screen, folded parts left out."""
    html = render_template("sections/finding.html.j2", data=finding(verdict), result=verdict)
    html = re.sub(r"<svg.*?</svg>", "", html, flags=re.DOTALL)
    open_parts = re.sub(r"</summary>.*?</details>", "</summary></details>", html, flags=re.DOTALL)
    return words(open_parts)


VOID = {"meta", "br", "link", "img", "hr", "input"}


class Balanced(HTMLParser):
    """Fails on a page whose elements do not close in order; collects ids and references."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.references: set[str] = set()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._look(attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._look(attrs)

    def handle_endtag(self, tag: str) -> None:
        assert self.open[-1:] == [tag], f"</{tag}> closes {self.open[-1:]}"
        self.open.pop()

    def _look(self, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            text = value or ""
            if name == "id":
                self.ids.append(text)
            if name in ("href", "src", "xlink:href"):
                self.addresses.append(text)
            self.references.update(re.findall(r"url\(#([^)]+)\)", text))


def check_page(page: str) -> list[str]:
    """A page is well formed and asks for nothing; its addresses that are no data."""
    parser = Balanced()
    parser.feed(page)
    parser.close()
    assert parser.open == []
    assert len(parser.ids) == len(set(parser.ids))
    inside = [a for a in parser.addresses if not a.startswith("data:text/csv;")]
    assert all(address.startswith("#") for address in inside)
    assert {a[1:] for a in inside} | parser.references <= set(parser.ids)
    outside = r"https?:|//|@import|<script[^>]*src|<link|url\((?!#)"
    assert not re.search(outside, without_sheet(page).replace("<!--", ""))
    assert page.startswith("<!DOCTYPE html>")
    return inside


def without_sheet(page: str) -> str:
    return re.sub(r"data:text/csv[^\"]*", "#", page)


def check_timeless(files: dict[str, str]) -> None:
    assert {"report.html", "result.json"} <= set(files)
    for name, content in files.items():
        text = content if isinstance(content, str) else content.decode("latin-1")
        text = without_sheet(text) if name == "report.html" else text
        text = re.sub(r'"npz": "[^"]*"', "", text)
        assert not re.search(r"/(?:home|root|tmp|usr|work|var)/", text), name
        assert str(Path.cwd()) not in text, name
        assert not re.search(r"\b20[2-9]\d-\d\d-\d\d", text), name
        assert not re.search(r"\bnan\b|\binf\b|Infinity|NaN|None|undefined", text), name


def test_the_key_numbers_are_on_the_page() -> None:
    estimate, text = published(), words(files_of()["report.html"])
    assert headline(result_of()).startswith(claim_text(result_of()))
    assert claim_text(result_of()) in text
    assert "These readings do not see the leg lengths." in text  # told by the priors alone
    assert "falls from 0.32 to 0.14 mm" in text
    assert "The model does not fit" in text
    # Beside distances of large noise the residual of touches was said to be below "the noise".
    assert "the noise of a reading is 0.02 mm; noise leaves as much with probability below" in text
    for name, value in estimate.values.items():
        low, high = (end * 1e3 for end in estimate.interval(name))
        sigma = estimate.sigmas[name] * 1e3
        places = decimals_for(sigma)
        assert f"{signed(value * 1e3, places)} ± {sigma:.{places}f}" in text
        assert f"{signed(low, places)} to {signed(high, places)}" in text
    assert f"{estimate.nominal.deviation_rms * 1e3:.3f}" in text
    assert f"{estimate.scores.cv_rms * 1e3:.3f}" in text
    assert "hardly see 3 combinations of joint offsets and leg lengths" in text
    assert "less than 10⁻⁹ mm" in text
    assert "orthoglide rerun result.json --out DIR" in text
    assert text.count("The residuals are") == 0  # said once, at the top, in plain words


# --- Figures --------------------------------------------------------------------------------


def test_figures_are_svg_with_a_panel_a_setup() -> None:
    estimate = published()
    drawings = {d.name: d for d in draw(result_of())}
    for drawing in drawings.values():
        root = ET.fromstring(re.sub(r"<!DOCTYPE[^>]*>", "", drawing.svg))
        assert root.tag.endswith("svg")
        inline = drawing.inline()
        ET.fromstring(inline)
        assert "var(--fig-ink)" in inline
        assert not [code for code in PALETTE.values() if code in inline]
    shown = drawings["readings"].inline_panels()
    assert len(shown) == len(estimate.problem.setups)
    titles = [f"{s.name}: leg" for c in estimate.problem.campaigns for s in c.setups]
    for title, panel in zip(titles, shown, strict=True):
        assert title in panel
        assert panel.count(": leg ") == 1


@pytest.mark.parametrize(
    ("limits", "most", "expected"),
    [
        ((-108.0, 68.0), 4, ["−100", "−50", "0", "50"]),
        ((-0.012, 0.012), 2, ["−0.01", "0.00", "0.01"]),
        ((-0.06, 0.05), 5, ["−0.050", "−0.025", "0.000", "0.025", "0.050"]),
        ((0.0, 9.5e5), 4, ["0", "250000", "500000", "750000"]),
        ((-3e-9, 3e-9), 4, ["−2·10⁻⁹", "0", "2·10⁻⁹"]),
        ((7.0, 7.0), 4, ["6.50", "6.75", "7.00", "7.25", "7.50"]),  # all readings at one place
    ],
)
def test_ticks_are_few_and_round(
    limits: tuple[float, float], most: int, expected: list[str]
) -> None:
    assert [words for _, words in round_ticks(limits, most)] == expected


# --- Words and numbers ----------------------------------------------------------------------


def test_numbers_for_people() -> None:
    assert signed(-0.5056, 2) == "−0.51"
    assert signed(-0.001, 2) == "0.00"
    assert (plain(0.25, 2), plain(-0.25, 2)) == ("0.25", "−0.25")
    pairs = [with_sigma(*one) for one in ((0.2617, 0.0031), (-0.7, 0.41), (109.2, 34.0), (3, 0))]
    assert pairs == ["0.2617 ± 0.0031", "−0.70 ± 0.41", "109 ± 34", "3.000"]
    assert [decimals_for(s) for s in (35.0, 3.5, 0.35, 0.02, 1e-9, 0.0)] == [0, 1, 2, 3, 6, 3]
    assert compact(1e-10, 1) == "10⁻¹⁰"
    assert compact(-2.5e-7, 2) == "−2.5·10⁻⁷"
    assert [compact(v, 2) for v in (-364.0, 3.64e7)] == ["−360", "3.6·10⁷"]
    assert [compact(v, plus=True) for v in (0.5, -0.5, 0.0)] == ["+0.5", "−0.5", "0"]
    assert compact(float("nan")) == "–"
    assert [probability(p) for p in (0.0, 0.012, 0.4)] == ["below 10⁻⁶", "0.012", "0.40"]


def test_weak_directions_in_words() -> None:
    pair = WeakDirection({"axis_tilt.x.y": 0.6, "axis_offset.x.y": -0.8}, 0.4, 0.4, "mm")
    blind = WeakDirection({"backlash.x": 1.0}, float("inf"), 0.02, "mm")
    first, second = weak_sentences([pair, blind])
    assert first == (
        "The readings cannot tell axis tilt of leg x toward y and axis offset of leg x toward y "
        "apart: together they may change by 0.4 mm (one sigma of the readings alone, "
        "without priors), and hardly any reading changes."
    )
    assert "it may change by any amount, and no reading changes" in second
    (many,) = weak_sentences([pair, blind, pair])
    assert "3 combinations of axis tilts, axis offsets and backlashes" in many
    assert "may change by any amount" in many
    assert "The tolerances, not the readings, narrow this to 0.02 mm" in second


# --- In a browser ---------------------------------------------------------------------------

MEASURE = """<script>
addEventListener("load", () => {
  document.querySelectorAll("details").forEach(e => { e.open = true; });
  const page = document.scrollingElement, wide = innerWidth;
  const out = [...document.querySelectorAll("main *, header *")].filter(e =>
    !e.closest("svg *, .scroll *") && e.getBoundingClientRect().right > wide + 1);
  const cut = [...document.querySelectorAll(".scroll")].filter(
    e => e.scrollWidth > e.clientWidth + 1);
  const flat = [...document.querySelectorAll("svg")].filter(
    e => e.getBoundingClientRect().height < 60);
  document.body.dataset.measured = JSON.stringify({
    inner: wide, page: page.scrollWidth, out: out.map(e => e.outerHTML.slice(0, 80)),
    cut: cut.map(e => e.innerText.slice(0, 40)), flat: flat.length,
    svgs: document.querySelectorAll("svg").length, height: page.scrollHeight });
});
</script></body>"""


def browser() -> str:
    found = next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
    )
    if not found and os.environ.get("CI") == "true":
        pytest.fail("no chromium: install Debian's chromium, the report must be seen in a browser")
    if not found:
        pytest.skip("no chromium: the report is not looked at in a browser")
    return found


def opened(page: str, width: int, folder: Path) -> SimpleNamespace:
    """What a headless browser measures on a page in a frame of the given width."""
    (folder / "page.html").write_text(page.replace("</body>", MEASURE), encoding="utf-8")
    # A window has a least width, a frame has none.
    (folder / "frame.html").write_text(
        f'<body style="margin:0"><iframe src="page.html" style="border:0" width="{width}" '
        f'height="800"></iframe><script>addEventListener("load", () => setTimeout(() => {{'
        f"document.title = document.querySelector('iframe').contentDocument.body.dataset.measured"
        f"}}, 200))</script></body>"
    )
    return SimpleNamespace(**browsed(folder / "frame.html", "1400,900", 3000))


def printed(page: Path) -> int:
    """Sheets of paper that a page takes."""
    paper = page.with_suffix(".pdf")
    command = [
        browser(), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
        f"--user-data-dir={page.parent / 'profile'}", f"--print-to-pdf={paper}", f"file://{page}",
    ]  # fmt: skip
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    return len(re.findall(rb"/Type\s*/Page[^s]", paper.read_bytes()))


def browsed(page: Path, size: str, budget: int, *flags: str) -> dict[str, Any]:
    """What a page has written into its title after some virtual milliseconds in a browser."""
    command = [
        browser(), "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
        "--no-first-run", "--disable-background-networking", "--disable-component-update",
        "--disable-sync", "--allow-file-access-from-files", f"--virtual-time-budget={budget}",
        f"--user-data-dir={page.parent / 'profile'}", f"--window-size={size}", "--dump-dom",
        *flags, f"file://{page}",
    ]  # fmt: skip
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    found = re.search(r"<title>(\{.*?\})</title>", shown, flags=re.DOTALL)
    assert found, shown[-500:]
    told: dict[str, Any] = json.loads(html.unescape(found[1]))
    return told
