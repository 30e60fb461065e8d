"""Write the gallery, an example of each verdict: ``python docs/images/gallery.py``.

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
from orthoglide.report.sentences import claim_text  # noqa: E402
from orthoglide.scene import drawing  # noqa: E402
from orthoglide.units import MM  # noqa: E402

NOISE = 5e-6
ZEROS = {"joint_offset.x": 5e-4, "joint_offset.y": -3e-4, "joint_offset.z": 8e-4}
NOMINAL = og.Machine.nominal()
HEAD = """# Gallery of verdicts

Compare your report with an example of its [verdict](closing-the-loop.md#verdicts): what to do, what
was hidden in a simulated machine, and what its readings showed. Made by `python
docs/images/gallery.py`. Blue is where each dial stood. *Tool* is its mean error over the workspace
after the best translation: now, with new zeros, and with compensated commands.
"""
ADVICE = {
    "explained": """Confirm the cause by its test, then repair it or compensate for it. Measure
again afterwards: `orthoglide check` reports what changed.""",
    "ambiguous": """Look at all the parts named; their tests decide. Readings that would decide, if
there are any, come first in the report.""",
    "located": """Look at the part by the curve of the report. The calibrated machine contains the
curve, so commands can be compensated for it. If it is common on your machines,
[declare it as an effect](../CONTRIBUTING.md#add-an-effect-in-four-steps).""",
    "partial": """The cause named may be only the nearest one known: confirm it before you change
anything, and measure where the residual is largest.""",
    "unexplained": """Change nothing by these readings. Take the readings proposed, and look for a
loose part, a dial that was touched, or dirt.""",
    "diffuse": """Enter the zeros. No single part is worth a repair; where the report advises
compensation, it corrects small errors of many parts.""",
    "adequate": """Enter the zeros. The report lists what these readings cannot show.""",
}
"""What to do about each verdict, whatever was found."""


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


def section(case: Case) -> str:
    """Return what was found, in Markdown, and write the drawing."""
    verdict = og.close_loop([case.campaign], NOMINAL)
    if verdict.word != case.name:
        raise SystemExit(f"{case.name} came out as {verdict.word}")
    drawn, shown = HERE / f"gallery-{case.name}.svg", verdict.picture
    svg = drawing(
        shown.posed, shown.options, shown.dials, title="The machine, what was found marked on it",
        first_shown=shown.first, standalone=True,
    )  # fmt: skip
    drawn.write_text(svg + "\n", encoding="utf-8")
    return "\n\n".join(
        [
            f"## {case.name.capitalize()}",
            ADVICE[case.name],
            f"Hidden: {case.hidden}.",
            f"![What was found](images/{drawn.name})",
            f"**{claim_text(verdict)}**",
            errors(verdict),
        ]
    )


def errors(verdict: og.Verdict) -> str:
    """Return the tool's error now and after each remedy, as a sentence."""
    tool = verdict.numbers.expected
    shown = ("now", "zeros", "compensated") if verdict.stands else ("now", "zeros")
    sizes = ", ".join(f"{name} {tool[name].shape * 1e3:.3f} mm" for name in shown)
    return f"Tool: {sizes}."


def page() -> str:
    """Return the page, and write the drawings."""
    return "\n".join([HEAD, *(section(case) + "\n" for case in cases())])


if __name__ == "__main__":
    path = HERE.parent / "gallery.md"
    path.write_text(page(), encoding="utf-8")
    print(f"written: {path}")
