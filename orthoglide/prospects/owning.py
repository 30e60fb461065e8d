"""What the instruments of an owner would tell of a machine, and what each further one would add."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orthoglide.instruments import OBSERVATIONS
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings, in_sequence
from orthoglide.planning.sheets import mixed_sheet, sheet_of, sheets_of
from orthoglide.prospects.detectable import Detectability, smallest_effects
from orthoglide.prospects.instruments import TAKEN_BY
from orthoglide.threads import on_one_thread

LARGEST = 3.0
"""Tolerances: an effect that is found only from more on counts as not shown."""


@dataclass(frozen=True)
class Gain:
    """What an instrument would add to those that one owns."""

    kind: str  # of its readings
    shown: tuple[str, ...]  # effects or parameters found within three tolerances, and not yet
    # those found already that could be told from all other effects, and not yet
    named: tuple[str, ...]

    def __str__(self) -> str:
        told = []
        if self.shown:
            told.append(f"show {', '.join(self.shown)}")
        if self.named:
            told.append(f"tell {', '.join(self.named)} from all else")
        return f"{TAKEN_BY[self.kind]} would {' and '.join(told) or 'tell nothing more'}"


@dataclass(frozen=True)
class Owned:
    """What instruments tell together, each by a sheet of its own.

    Attributes:
        sheets: by kind, the readings they would take.
        tells: smallest effects found and named.
        gains: of the instruments that are not among them.
    """

    sheets: dict[str, Readings]
    tells: Detectability
    gains: tuple[Gain, ...]

    def __repr__(self) -> str:
        listed = ", ".join(f"{TAKEN_BY[k]} ({len(s)})" for k, s in self.sheets.items())
        return f"<Owned: {listed}>"

    def to_fill_in(self) -> list[Readings]:
        """The sheets of the tool's readings without these, in one sequence."""
        of_tool = [s for s in self.sheets.values() if s.of_tool]
        return in_sequence([replace(s, reading=np.full(len(s), np.nan)) for s in of_tool])


@on_one_thread
def owned_instruments(
    machine: MachineSource, kinds: Sequence[str], *, count: int | None = None, seed: int = 0
) -> Owned:
    """What one's instruments would tell of a machine.

    Args:
        machine: as it is believed to be; its instruments say how well they read.
        kinds: of readings that one can take: ``leg``, ``tcp``, ``plate`` ...
        count: of the tool's readings to choose among all of these; all where absent.
        seed: of the bootstrap on noise.

    Raises:
        InputError: for a kind that there is not, or that this machine does not take; for a count
            that cannot be chosen.
    """
    machine = Machine.of(machine)
    sheets = sheets_of(machine, kinds)
    if count is not None:
        of_tool = [s for s in sheets.values() if s.of_tool]
        chosen = {s.name: s for s in mixed_sheet(machine, of_tool, count)}
        sheets = {k: chosen.get(k, s) for k, s in sheets.items() if k in chosen or s.on_legs.any()}
    tells = smallest_effects(machine, list(sheets.values()), seed=seed)
    gains = []
    for kind in TAKEN_BY:
        on_leg = OBSERVATIONS[kind].on_leg
        if kind not in sheets and (machine.geometry.dialled or not on_leg):
            more = [*sheets.values(), sheet_of(machine, kind)]
            of_machine = {e.name for e in machine.catalogue.effects if not e.of_dial}
            gained = smallest_effects(machine, more, seed=seed)
            gains.append(_gain(kind, tells, gained, of_machine))
    return Owned(sheets, tells, tuple(gains))


def _gain(
    kind: str, before: Detectability, after: Detectability, of_machine: Collection[str]
) -> Gain:
    """What an instrument tells of the machine: to show its own faults nobody reads it."""

    def within(found: Detectability, what: str) -> dict[str, str]:
        return {
            s.name.plain: s.effect
            for s in found.smallest
            if s.elementary and s.effect in of_machine and getattr(s, what) <= LARGEST * s.tolerance
        }

    members: dict[str, set[str]] = {}
    for s in (*before.smallest, *after.smallest):
        if s.elementary:
            members.setdefault(s.effect, set()).add(s.name.plain)

    def new(now: dict[str, str], earlier: dict[str, str]) -> tuple[str, ...]:
        """Names, an effect's own where all its parameters are among them."""
        found = {n: e for n, e in now.items() if n not in earlier}
        whole = {e for e in found.values() if members[e] <= found.keys()}
        return tuple(dict.fromkeys(e if e in whole else n for n, e in found.items()))

    found = within(before, "detectable")
    named = {n: e for n, e in within(after, "nameable").items() if n in found}
    return Gain(kind, new(within(after, "detectable"), found),
                new(named, within(before, "nameable")))  # fmt: skip
