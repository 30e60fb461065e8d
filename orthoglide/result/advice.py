"""What follows from a result: what to do, and what to measure next."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from orthoglide.result.codec import Key, SampledMetres, Share, in_mm_short

Kind = Literal["zeros", "confirm", "mend", "compensate", "measure"]

_ADVISED = {"zeros": "zeros", "mend": "repair", "compensate": "compensate", "measure": "measure"}


@dataclass(frozen=True)
class Suspect:
    """One of the causes for which a part is examined."""

    words: str  # what would be wrong, as a clause with sign, size and unit
    look_at: str  # on the machine
    confirm: str  # a test with the reading to expect; empty where there is none


@dataclass(frozen=True)
class Action:
    """One thing to do."""

    # `zeros` to enter, a cause to `confirm` or to `mend`, commands to `compensate`, or readings to
    # `measure`
    kind: Annotated[Kind, Key("action")]
    words: str  # what to do, a sentence without its full stop
    # by how much the tool's mean error over the workspace falls, best shift removed, of numbers for
    # a firmware what its equations leave of heights; nan of what changes nothing on the machine
    gain: SampledMetres = math.nan
    gain_sigma: SampledMetres = math.nan  # standard deviation of that; nan where it is not known
    options: tuple[Suspect, ...] = ()  # causes to look for, most probable first
    whichever: bool = False  # whether `gain` is the mean over the options, of which one is there
    plate: bool = False  # whether an option is the plate's own, which moves no tool


@dataclass(frozen=True)
class Withheld:
    """Something that is not advised."""

    kind: Literal["zeros", "compensate"]
    reason: str  # a clause


def advised(actions: tuple[Action, ...]) -> list[dict[str, Any]]:
    """Return actions as the entries of ``advice`` in ``result.json``, without those to confirm."""
    return [
        {
            "kind": _ADVISED[one.kind], "words": one.words,
            "gain_mm": in_mm_short(one.gain), "gain_sigma_mm": in_mm_short(one.gain_sigma),
        }
        for one in actions
        if one.kind in _ADVISED
    ]  # fmt: skip


@dataclass(frozen=True)
class Proposal:
    """A few readings to take next, and why."""

    reason: str  # what they are for and what is to be expected of them, in words
    # `separate` rivals, `narrow` a weak direction, `trace` what nothing explains, or `none`
    aim: str
    # for rivals the sigmas between the two least separated, by another instrument between the two
    # most; for a direction how many times narrower it gets; nan of what nothing explains
    gain: Share
    readings: tuple[Mapping[str, str], ...]  # rows as campaign files have them, no reading in them
    what: str  # what to measure, without the expected outcome; empty: the whole reason
    other_instrument: bool  # whether it takes another instrument or another way of measuring
    hopeless: bool  # whether no reading within reach helps
