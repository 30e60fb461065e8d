"""A result as pages show it: what to do, the machine, the TCP over the workspace, the readings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.geometry import Array
from orthoglide.result.codec import (
    SHORT_DIGITS,
    Key,
    MetresField,
    SampledMetres,
    Share,
    in_mm_short,
)
from orthoglide.scene import Dial, Option, Posed, drawing

Kind = Literal["zeros", "confirm", "mend", "compensate", "measure"]

_ADVICE_NAMES = {
    "zeros": "zeros", "mend": "repair", "compensate": "compensate", "measure": "measure",
}  # fmt: skip


@dataclass(frozen=True)
class Suspect:
    """A possible cause with the part to examine."""

    words: str  # the error with sign, size and unit, a clause
    look_at: str  # part of the machine to look at
    confirm: str  # a test with the expected reading; empty if there is none


@dataclass(frozen=True)
class Action:
    """One thing to do."""

    # `zeros` to enter, a cause to `confirm` or to `mend`, commands to `compensate`, or readings to
    # `measure`
    kind: Annotated[Kind, Key("action")]
    words: str  # what to do, a sentence without its full stop
    # decrease of the tool's mean error over the workspace after the best translation, or for
    # numbers of a firmware of the residual of its equations; nan for actions that change nothing
    gain: SampledMetres = math.nan
    gain_sigma: SampledMetres = math.nan  # standard deviation of `gain`; nan if unknown
    options: tuple[Suspect, ...] = ()  # causes to look for, most probable first
    whichever: bool = False  # whether `gain` is the mean over the options, one of which is true
    plate: bool = False  # whether an option is an error of the plate, which does not move the tool


@dataclass(frozen=True)
class Withheld:
    """Something that is not advised."""

    kind: Literal["zeros", "compensate"]
    reason: str  # a clause


def advice_rows(actions: tuple[Action, ...]) -> list[dict[str, Any]]:
    """Return the entries of ``advice`` in ``result.json``: actions except causes to confirm."""
    return [
        {
            "kind": _ADVICE_NAMES[one.kind], "words": one.words,
            "gain_mm": in_mm_short(one.gain), "gain_sigma_mm": in_mm_short(one.gain_sigma),
        }
        for one in actions
        if one.kind in _ADVICE_NAMES
    ]  # fmt: skip


@dataclass(frozen=True)
class Proposal:
    """A few readings to take next, and why."""

    reason: str  # their purpose and the expected outcome, in words
    # `separate` rivals, `narrow` a weak direction, `trace` an unexplained residual, or `none`
    aim: str
    # separation in sigmas of the two least separated rivals, by another instrument of the two most
    # separated; ratio of standard deviations of a weak direction; nan for a residual
    gain: Share
    readings: tuple[Mapping[str, str], ...]  # rows of a campaign file, without readings
    what: str  # what to measure, without the expected outcome; empty: the whole reason
    other_instrument: bool  # whether it takes another instrument or another way of measuring
    hopeless: bool  # whether no feasible reading helps


_PLACES = 12  # decimals of an SI unit: a picometre is rounding

Rows = Annotated[Array, Key(places=_PLACES)]
Numbers = NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class Picture:
    """A drawing of the machine with the findings."""

    posed: Posed  # the nominal machine at mechanical zero
    dials: tuple[Dial, ...]  # dials at their places
    options: tuple[Option, ...]  # explanations of every finding, most probable first
    first: tuple[int, ...]  # number of the most probable option of every finding

    def svg(self) -> str:
        """Return the drawing as SVG for a page."""
        title = "The machine, what was found marked on it" if self.options else "The machine"
        return drawing(self.posed, self.options, self.dials, title=title, first_shown=self.first)


@dataclass(frozen=True, eq=False, repr=False)
class Workspace:
    """The TCP over the workspace, best translation removed, metres."""

    # A regular grid (g, 3): travel from mechanical zero on the Orthoglide, else positions of the
    # tool. With screws, errors are those at a position a fraction of a turn away.
    at: MetresField
    axis: str  # name of a column, with a placeholder for the axis
    now: MetresField  # predicted error without corrections (g, 3)
    left: MetresField  # predicted error with offsets and lengths of the base model corrected (g, 3)
    sure_before: MetresField  # 95 % radius about the base model by the full model (g,)
    sure: MetresField  # 95 % radius about the calibrated machine by the full model (g,)

    @property
    def nominal(self) -> Array:
        """Length of ``now`` ``(g,)``."""
        return np.linalg.norm(self.now, axis=1)

    @property
    def before(self) -> Array:
        """Length of ``left`` ``(g,)``."""
        return np.linalg.norm(self.left, axis=1)

    def stages(self, improved: bool) -> list[tuple[str, Array]]:
        """Return what table and figure show, in words, each with its values ``(g,)``, errors before
        the radius; ``improved``: whether the final model differs from the base model.
        """
        shown = improved and self.left.any()  # nothing is left if the base model was calibrated
        corrected = [("offsets and lengths corrected", self.before)] if shown else []
        errors = [("predicted error", self.nominal), *corrected]
        return [*errors, ("95 % radius of the prediction", self.sure)]

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields: mean and largest."""
        figures = {
            "predicted_error_nominal": self.nominal,
            "predicted_error_before": self.before,
            "uncertainty_95_before": self.sure_before,
            "uncertainty_95_after": self.sure,
        }
        return {
            name: {"mean_mm": in_mm_short(float(v.mean())), "max_mm": in_mm_short(float(v.max()))}
            for name, v in figures.items()
        }


@dataclass(frozen=True, eq=False, repr=False)
class Mounting:
    """The readings of one setup for a panel of a figure."""

    setup: str  # name of the setup
    name: str  # name of the setup, with its campaign before it if there are several
    title: str  # of the panel: name, leg and direction
    label: str  # of the horizontal axis
    rows: Numbers  # rows of `ReadingsShown` that belong to it (m,)
    # travel of the touched leg's carriage in millimetres, or number in the file (m,)
    x: Annotated[Array, Key(digits=SHORT_DIGITS)]
    unit: str  # unit for display: mm or mrad


@dataclass(frozen=True, eq=False, repr=False)
class ReadingsShown:
    """All readings that were fitted, measured and predicted, metres or radians."""

    mountings: tuple[Mounting, ...]  # in the order of the files
    file: Numbers  # number of the readings within the request (n,)
    row: Numbers  # row within these readings (n,)
    measured: Rows  # (n,)
    sigma: Rows  # standard deviation of the noise that is independent in each reading (n,)
    nominal: Rows  # predicted for the machine as it was (n,)
    before: Rows  # predicted by the base model (n,)
    after: Rows  # predicted by the last fit (n,)

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def turned(self) -> NDArray[np.bool_]:
        """Whether each reading is an inclination ``(n,)``."""
        turned = np.zeros(len(self), dtype=bool)
        for mounting in self.mountings:
            turned[mounting.rows] = mounting.unit == "mrad"
        return turned
