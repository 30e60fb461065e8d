"""What to do about the findings of a result, and what to measure next."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from orthoglide.result.codec import Key, SampledMetres, Share, in_mm_short

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
