"""Write the gallery, one section a verdict: ``python docs/images/gallery.py``.

Machines are made up and their dials simulated; what is wrong with each is said beside what was
found. One is the published machine.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

import orthoglide as og  # noqa: E402
from orthoglide.report import report_files  # noqa: E402
from orthoglide.report.first import finding  # noqa: E402
from orthoglide.report.wording import MEANINGS, claim, evidence  # noqa: E402

NOISE = 5e-6
ZEROS = {"joint_offset.x": 5e-4, "joint_offset.y": -3e-4, "joint_offset.z": 8e-4}
HEAD = """# Gallery of verdicts

Made by `python docs/images/gallery.py`. Every verdict with the first screen of its report: what was
hidden in the machine, what was found, drawn on the machine, and what to do.
"""


def swept(values: dict[str, float], machine: og.Machine | None = None) -> og.Campaign:
    """A sweep of a machine with its zeros off as on any, and something wrong besides."""
    worn = (machine or og.Machine.nominal()).with_parameters({**ZEROS, **values})
    return replace(og.simulate(worn, "sweep", noise=NOISE, seed=1), name="sweep")


def wavy() -> og.Campaign:
    """A rail that leaves its line as no shape of the catalogue does."""
    bump = og.Effect(
        "bump", og.CATALOGUE_UNIT, 0.05, because="it is made up", sentence="the rail has a bump",
        look_at="the rail",
        members=og.sideways(
            lambda axis, _: (og.Motion(f"lateral_{axis}", lambda c: np.exp(-((c.u / 0.4) ** 2))),)
        ),
    )  # fmt: skip
    return swept({"bump.x.y": 2e-4}, og.Machine.nominal().with_effects([bump]))
