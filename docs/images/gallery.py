"""Write the gallery, a section for each verdict: ``python docs/images/gallery.py``.

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
from orthoglide.report.phrases import sentence  # noqa: E402
from orthoglide.report.wording import MEANINGS, claim, evidence  # noqa: E402
from orthoglide.units import MM  # noqa: E402

NOISE = 5e-6
ZEROS = {"joint_offset.x": 5e-4, "joint_offset.y": -3e-4, "joint_offset.z": 8e-4}
NOMINAL = og.Machine.nominal()
HEAD = """# Gallery of verdicts

Made by `python docs/images/gallery.py`: what was hidden in a machine, what its readings showed, and
what to do. The drawings are those of the reports; blue is where each dial stood.
"""


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
    yield Case("adequate", "nothing but the zeros", sound)


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


def section(case: Case) -> str:
    """What was found, in Markdown; writes the drawing."""
    verdict = og.close_loop([case.campaign], NOMINAL)
    if verdict.word != case.name:
        raise SystemExit(f"{case.name} came out as {verdict.word}")
    drawn = HERE / f"gallery-{case.name}.svg"
    drawn.write_text(verdict.picture.svg(alone=True) + "\n", encoding="utf-8")
    tool = verdict.numbers.expected
    shown = ("now", "zeros", "compensated") if verdict.stands else ("now", "zeros")
    sizes = ", ".join(f"{name} {tool[name].shape * 1e3:.3f} mm" for name in shown)
    steps = []
    for action in verdict.actions:
        gain = f" Gains {action.gain * 1e3:.3f} mm." if action.gain > 0 else ""
        steps.append(f"1. {action.words}.{gain}")
        steps += [
            "   - "
            + " ".join(
                map(sentence, filter(None, (one.words, f"look at {one.look_at}", one.confirm)))
            )
            for one in action.options
        ]
    return "\n".join(
        [
            f"\n## {case.name.capitalize()}: {MEANINGS[verdict.word]}\n",
            f"Hidden in the machine: {case.hidden}.\n",
            f"![The machine, what was found marked on it](images/{drawn.name})\n",
            f"**{claim(verdict)}**\n",
            f"{evidence(verdict)}\n",
            f"The tool's mean error over the workspace, best shift removed: {sizes}.\n",
            *steps,
        ]
    )


if __name__ == "__main__":
    text = HEAD + "\n".join(map(section, cases())) + "\n"
    (HERE.parent / "gallery.md").write_text(text, encoding="utf-8")
    print(f"written: {HERE.parent / 'gallery.md'}")
