"""Write the gallery, a page for each verdict: ``python docs/images/gallery.py``.

Machines are made up and their dials simulated, but for the published one; what is wrong with each
is said beside what was found.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

import orthoglide as og  # noqa: E402
from orthoglide.effects.wording import cause_words  # noqa: E402
from orthoglide.report.words import MEANINGS, claim, evidence  # noqa: E402
from orthoglide.text import sentence  # noqa: E402
from orthoglide.units import MM  # noqa: E402

NOISE = 5e-6
ZEROS = {"joint_offset.x": 5e-4, "joint_offset.y": -3e-4, "joint_offset.z": 8e-4}
NOMINAL = og.Machine.nominal()
HEAD = """# Gallery of verdicts

One page for each verdict, made by `python docs/images/gallery.py`: what was hidden in a machine,
what its readings showed, and what to do. The drawings are those of the reports; blue is where each
dial stood.

| verdict | what it says |
|---|---|
"""
ADVICE = {
    "explained": """Confirm the cause by the test named below, which needs no program, then mend it
or compensate for it. Measure again afterwards: `orthoglide check` says what changed.""",
    "ambiguous": """Look at all the parts named: the tests below decide. Where readings would
decide, the report proposes them, and they come first.""",
    "located": """Look at the part by the curve of the report, which says where along the travel it
goes wrong. What was found is in the calibrated machine, so commands can be compensated for it
without a name. If it is common on your machines,
[declare it as an effect](../../CONTRIBUTING.md#add-an-effect-in-four-steps).""",
    "partial": """The cause named may be no more than the nearest one known to one that is not
known: confirm it before anything is changed. Numbers for the controller are withheld. Then measure
where the rest shows.""",
    "unexplained": """Change nothing by these readings. Numbers for the controller are withheld.
Take the readings proposed, where most is left, and look for what no smooth cause does: a loose
part, a dial that was touched, dirt.""",
    "diffuse": """Enter the zeros. No single part stands out, so none is worth a repair: what small
errors of many parts do to the tool, the calibrated machine and its compensation take away.""",
    "adequate": """Enter the zeros. It does not say that the machine is perfect: what these readings
cannot show is listed in the report as invisible.""",
}
"""What to do about each verdict, whatever was found."""
FOOT = """How a verdict is reached: [Closing the loop](../closing-the-loop.md#verdicts). How often
it is right: [the truth table](../truth-table.md#verdicts)."""


@dataclass(frozen=True)
class Case:
    """A machine with what is wrong with it.

    Attributes:
        name: of its drawing.
        hidden: what is wrong, in words.
        campaign: its readings.
    """

    name: str
    hidden: str
    campaign: og.Campaign


def swept(values: Mapping[str, float], machine: og.Machine = NOMINAL) -> og.Campaign:
    """A sweep of a machine with its zeros off as on any, and something wrong besides."""
    worn = machine.with_parameters({**ZEROS, **values})
    return replace(og.simulate(worn, "sweep", noise=NOISE, seed=1), name="sweep")


def known(name: str, values: Mapping[str, float]) -> Case:
    """A cause of the catalogue."""
    (parameter,) = values
    return Case(name, cause_words(NOMINAL.catalogue, parameter, values), swept(values))


def cases() -> Iterator[Case]:
    """One for each verdict."""
    yield known("explained", {"rail_bow.x.z": 1.5e-4})
    yield known("ambiguous", {"axis_offset.z.x": 4e-4})
    yield Case(
        "located",
        "the path of the x carriage has an S toward y, 0.1 mm to either side, which no effect of "
        "the catalogue has",
        swept({"s_shape.x.y": 1e-4}, NOMINAL.with_effects([s_shape()])),
    )
    tilted = swept({"axis_tilt.y.z": 5e-3})
    odd = "an error of its own at every station, 0.04 mm (standard deviation)"
    yield Case(
        "partial",
        f"{cause_words(NOMINAL.catalogue, 'axis_tilt.y.z', {'axis_tilt.y.z': 5e-3})}, and {odd}",
        tilted.with_readings(tilted.reading + scattered(tilted)),
    )
    sound = swept({})
    yield Case("unexplained", odd, sound.with_readings(sound.reading + scattered(sound)))
    worn = "every part off by about a third of its tolerance, none by more than the others"
    yield Case("diffuse", worn, swept(little()))
    yield Case("adequate", "nothing but the zeros", sound)


def little() -> dict[str, float]:
    """A third of the tolerance of everything that a sweep's dials can show."""
    rng, catalogue = np.random.default_rng(5), NOMINAL.catalogue
    names = [str(n) for e in catalogue.effects if e.at_rest and not e.of_dial and not e.instead_of
             for n in catalogue.expand([e.name])]  # fmt: skip
    names = [n for n in names if n not in ZEROS]
    return {n: 0.3 * NOMINAL.tolerance(n) * float(rng.standard_normal()) for n in names}


def s_shape() -> og.Effect:
    """A path that the catalogue does not know."""
    return og.Effect(
        "s_shape", MM, 0.05, because="it is made up", sentence="the path has an S",
        look_at="the rail",
        members=og.sideways(
            lambda axis, _: (og.Motion(f"lateral_{axis}", lambda c: 2.6 * c.u * (c.u * c.u - 1)),)
        ),
    )  # fmt: skip


def scattered(sheet: og.Campaign) -> np.ndarray:
    """Another error at every station: nothing smooth does that."""
    stations = np.column_stack([sheet.setup, sheet.command, sheet.approach])
    _, at = np.unique(stations, axis=0, return_inverse=True)
    return np.random.default_rng(3).normal(scale=4e-5, size=at.max() + 1)[at.reshape(-1)]


def page(case: Case) -> str:
    """What was found, in Markdown; writes the drawing."""
    verdict = og.close_loop([case.campaign], NOMINAL)
    if verdict.word != case.name:
        raise SystemExit(f"{case.name} came out as {verdict.word}")
    drawn = HERE / f"gallery-{case.name}.svg"
    drawn.write_text(verdict.picture.svg(alone=True) + "\n", encoding="utf-8")
    return "\n".join(
        [
            f"# {case.name.capitalize()}\n",
            f"{sentence(MEANINGS[verdict.word])}\n",
            f"{ADVICE[case.name]}\n",
            "## An example\n",
            f"Hidden in the machine: {case.hidden}.\n",
            f"![The machine, what was found marked on it](../images/{drawn.name})\n",
            f"**{claim(verdict)}**\n",
            f"{evidence(verdict)}\n",
            *steps(verdict),
            "",
            FOOT,
        ]
    )


def steps(verdict: og.Verdict) -> list[str]:
    """The tool's error now and later, and what to do, as lines."""
    tool = verdict.numbers.expected
    shown = ("now", "zeros", "compensated") if verdict.stands else ("now", "zeros")
    sizes = ", ".join(f"{name} {tool[name].shape * 1e3:.3f} mm" for name in shown)
    lines = [f"The tool's mean error over the workspace, best shift removed: {sizes}.\n"]
    for action in verdict.actions:
        gain = f" Gains {action.gain * 1e3:.3f} mm." if action.gain > 0 else ""
        lines.append(f"1. {action.words}.{gain}")
        lines += [
            "   - "
            + " ".join(
                map(sentence, filter(None, (one.words, f"look at {one.look_at}", one.confirm)))
            )
            for one in action.options
        ]
    return lines


if __name__ == "__main__":
    folder = HERE.parent / "gallery"
    folder.mkdir(exist_ok=True)
    rows = ""
    for case in cases():
        (folder / f"{case.name}.md").write_text(page(case) + "\n", encoding="utf-8")
        link = f"[{case.name}](gallery/{case.name}.md)"
        rows += f"| {link} | {sentence(MEANINGS[case.name])} |\n"  # type: ignore[index]
    folder.with_suffix(".md").write_text(HEAD + rows, encoding="utf-8")
    print(f"written: {folder}")
