"""Pictures of every effect of the catalogue: its mark on the machine, what it does to readings."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np

import orthoglide as og
import orthoglide.figures.style as style
from orthoglide.effects.wording import value_words
from orthoglide.figures.axes import Limits, Panel, padded, round_ticks
from orthoglide.figures.style import Drawing
from orthoglide.geometry import LEGS, Array
from orthoglide.pictures import dials, option
from orthoglide.prediction import MeasurementModel
from orthoglide.scene import drawing

WARMING, LOAD, PITCH = 10.0, 10.0, 0.02  # K over the sheet, N, metres
_STEP = 1e-5  # of base parameters, SI: readings are linear in so little
_PANEL = (180.0, 97.0)  # SVG units: two abreast can be read on a phone
_KEY = f"""
The pictures show one tolerance of that parameter of an effect which a sweep
(`orthoglide protocol --kind sweep`) shows best. On the drawing it is seen after a move outward, an
hour later, 10 K warmer, under 10 N. The panels have what it changes in the readings: grey as the
dial shows it, blue what is left when datums, joint offsets and leg lengths have been fitted, by
which it can be found. Each panel is a dial, over the travel of the touched leg's carriage. The
machine is that of the demo, with a screw of {PITCH * 1e3:g} mm lead; over the sweep it warms by
{WARMING:g} K, and its second round is under {LOAD:g} N.
"""


class Sheet:
    """A sweep on the machine of the demo, and what a fit of the base can explain of its rows.

    Attributes:
        machine: of the demo.
        campaign: the rows ``(n,)``.
        fitted: orthonormal columns of datums and base parameters ``(n, q)``.
    """

    def __init__(self) -> None:
        with (files("orthoglide") / "data" / "made-up.toml").open("rb") as file:
            machine = og.Machine.load(file.name)
        self.machine = og.Machine(replace(machine.spec, screw_pitch=PITCH))
        sheet = og.protocol("sweep", machine.geometry)
        n = len(sheet)
        self.campaign = replace(sheet, temperature=np.linspace(20, 20 + WARMING, n),
                                load=np.where(sheet.repeat == 2, LOAD, 0.0))  # fmt: skip
        catalogue = machine.catalogue
        base = [p for name in catalogue.base for p in catalogue[name].parameters()]
        datums = np.eye(len(sheet.setups))[sheet.setup]
        slopes = [self.change(name, _STEP) / _STEP for name in base]
        self.fitted = np.linalg.qr(np.column_stack([datums, *slopes]))[0]

    def change(self, name: str, value: float) -> Array:
        """What so much more of a parameter, SI, changes in the readings ``(n,)``, metres."""
        values = self.machine.values
        more = {**values, name: values.get(name, 0.0) + value}
        model = self.machine.model
        readings = MeasurementModel(self.campaign)
        return np.asarray(readings.predict(model, more) - readings.predict(model, values))

    def left(self, name: str, value: float) -> Array:
        """The same ``(n,)``, past what datums and base parameters explain."""
        change = self.change(name, value)
        return np.asarray(change - self.fitted @ (self.fitted.T @ change))


def illustrate(page: Path) -> None:
    """Put the pictures beside the page of the effects, and into it."""
    text, sheet = page.read_text(encoding="utf-8"), Sheet()
    head, _, rest = text.partition("\n## ")
    text = f"{head}{_KEY}\n## {rest}"
    for effect in sheet.machine.catalogue.values():
        if effect.plate:  # no dial on a leg shows it
            continue
        begin, title, body = text.partition(f"\n### {effect.name}\n")
        said, shown = draw(effect, sheet, page.parent / "images")
        machine, readings = (f"images/{shown}-{part}.svg" for part in ("machine", "readings"))
        pictures = f"![{said}]({machine})\n![What it does to the readings]({readings})"
        text = f"{begin}{title}\n{pictures}\n\nAt one tolerance: {said}.\n{body}"
    page.write_text(text, encoding="utf-8")


def draw(effect: og.Effect, sheet: Sheet, folder: Path) -> tuple[str, str]:
    """Write both pictures of an effect; its words at one tolerance, and the files' stem."""
    setup, stem = sheet.campaign.setups[0].name, f"effect-{effect.name}"
    value = effect.tolerance_si
    name = max(effect.parameters((setup,)), key=lambda n: np.linalg.norm(sheet.left(n, value)))
    words = value_words(effect, name, value)
    posed = sheet.machine.with_only({}).posed()
    marked = option(sheet.machine, words, {name: value})
    svg = drawing(posed, [marked], dials(posed, [sheet.campaign]), title=words, standalone=True)
    (folder / f"{stem}-machine.svg").write_text(svg, encoding="utf-8")
    svg = panels(sheet, sheet.change(name, value), sheet.left(name, value))
    (folder / f"{stem}-readings.svg").write_text(svg, encoding="utf-8")
    return words, stem


def panels(sheet: Sheet, change: Array, left_over: Array) -> str:
    """Changes and what is left of them ``(n,)``, metres, a panel a dial, as SVG."""
    campaign, zero = sheet.campaign, sheet.machine.geometry.zero
    first = np.array([np.flatnonzero(campaign.setup == k)[0] for k in campaign.setup])
    shown = (change - change[first]) * 1e3
    reach = 1.1 * max(np.abs(shown).max(), np.abs(left_over).max() * 1e3, 1e-9)
    width, height = _PANEL
    lines = -(-len(campaign.setups) // 2)
    size = (2 * width, lines * height + 14.0)
    panel = Panel((0.0, 0.0, *size))
    for k, setup in enumerate(campaign.setups):
        rows, left, top = campaign.setup == k, k % 2 * width, k // 2 * height
        travel = (campaign.command[rows, setup.leg] - zero[setup.leg]) * 1e3
        x, y = padded(travel, 0.05), (-reach, reach)
        axes = panel.add_axes(x, y, left + 43.0, top + 18.0, width - left + 7.0,
                              size[1] - top - height + 18.0)  # fmt: skip
        axes.line(travel, shown[rows], style.BEFORE, 2.2)
        axes.line(travel, left_over[rows] * 1e3, style.FIT)
        axes.set_title(f"leg {LEGS[setup.leg]}, along {setup.direction}, mm")
        # Scales are the same for all.
        lowest, leftmost = k // 2 == lines - 1, k % 2 == 0
        axes.set_x_axis(_ticks(x, lowest), "travel, mm" if lowest else "")
        axes.set_y_axis(_ticks(y, leftmost))
    return Drawing("readings", "What it does to the readings", size, (panel.svg(),)).svg


def _ticks(limits: Limits, labelled: bool) -> list[tuple[float, str]]:
    return [(value, words if labelled else "") for value, words in round_ticks(limits)]
