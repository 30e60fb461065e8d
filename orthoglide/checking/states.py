"""Two states of one machine, given as readings or as results, and their requests."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from orthoglide.effects import Effect
from orthoglide.errors import InputError
from orthoglide.files import result_file
from orthoglide.fit import readings_of
from orthoglide.machine import Machine
from orthoglide.observations import Readings, ReadingsOrPath
from orthoglide.result.request import Request, read_result, request_of

State = ReadingsOrPath | Sequence[ReadingsOrPath] | Request
"""Readings, a request, or the path of a ``result.json`` or of its folder."""


@dataclass(frozen=True)
class States:
    """One machine and its readings in two states."""

    machine: Machine  # machine of both states
    old: tuple[Readings, ...]
    new: tuple[Readings, ...]
    noise: float | None  # largest declared standard deviation of a reading, metres


def read_states(
    old: State, new: State, given: Machine | None = None, effects: tuple[Effect, ...] = ()
) -> States:
    """Return the machine and the readings of both states.

    Args:
        old: the state before.
        new: the state after.
        given: the machine of both states; by default that of a result, otherwise the nominal one.
        effects: user-defined effects of machines that are loaded.

    Raises:
        InputError: if a side has no readings, or the two are of different machines.
    """
    states = [_load_run(state, effects) for state in (old, new)]
    requests = [state for state in states if isinstance(state, Request)]
    nominal = Machine.nominal().with_effects(effects)
    default = given or next((request.machine for request in requests), nominal)
    machines = [s.machine if isinstance(s, Request) else default for s in states]
    before, after = (
        s.readings if isinstance(s, Request) else readings_of(s, default) for s in states
    )
    names = [
        str(state) if isinstance(state, str | os.PathLike) else ", ".join(r.name for r in readings)
        for state, readings in ((old, before), (new, after))
    ]
    if given is not None:
        for name, machine in zip(names, machines, strict=True):
            _check_firmware_numbers(name, machine, given.spec.file or "the machine", given)
        machines = [given, given]
    _check_firmware_numbers(names[0], machines[0], names[1], machines[1])
    if machines[0].geometry != machines[1].geometry:
        raise InputError(
            f"{names[0]} and {names[1]} are of machines of different dimensions "
            f"({machines[0].spec.title}; {machines[1].spec.title}): check compares two states of "
            f"one; where the file was corrected since, and no number that the controller counts "
            f"with, give it for both with --machine (machine=); what other numbers of a controller "
            f"left, close-loop tells from the new readings"
        )
    declared = [request.noise for request in requests if request.noise is not None]
    return States(machines[0], before, after, max(declared, default=None))


def _load_run(state: State, effects: tuple[Effect, ...]) -> State:
    """Return the request of a result at a path; other states unchanged."""
    if not isinstance(state, str | os.PathLike):
        return state
    path = Path(state)
    if path.suffix == ".toml":
        raise InputError(
            f"{path} is a machine file, which has no readings: give the result.json beside "
            f"it, or the campaign"
        )
    path = result_file(path, "result.json")
    return request_of(read_result(path), str(path), effects) if path.suffix == ".json" else state


def _check_firmware_numbers(
    first_name: str, first: Machine, second_name: str, second: Machine
) -> None:
    """Refuse two imports with different numbers of the firmware, because equal commands then mean
    different carriage heights, and pasted numbers would be reported as changes.
    """
    marks = first.spec.firmware, second.spec.firmware
    if all(marks) and marks[0] != marks[1]:
        raise InputError(
            f"{first_name} was imported with other numbers of the firmware ({marks[0]}) than "
            f"{second_name} ({marks[1]}): check compares two states under the same numbers; what "
            f"the numbers changed between the visits left, close-loop tells from the new readings "
            f"with the machine.toml of their import"
        )


def joint_request(
    machine: Machine,
    before: Sequence[Readings],
    after: Sequence[Readings],
    noise: float | None,
    seed: int,
) -> tuple[Request, bool]:
    """Return the request of both states, and whether it omits old readings of the tool.

    A fit has the dials first and assigns readings of the tool to the last state, so old ones are
    omitted if the new state has dials.
    """
    with_dials = not all(one.of_tool for one in after)
    kept = [one for one in before if not (with_dials and one.of_tool)]
    request = Request("close-loop", (*kept, *after), machine, (), noise, seed)
    return request, len(kept) < len(before)


def with_distinct_names(
    old: Sequence[Readings], new: Sequence[Readings]
) -> tuple[list[Readings], list[Readings]]:
    """Return the campaigns of both sides with distinct names. A setup at the tool that is the only
    one of its kind at both visits gets the same name at both.
    """
    new_names, old_names = (_unique_setups_by_kind(side) for side in (new, old))
    renames = {name: new_names[kind] for kind, name in old_names.items() if kind in new_names}

    def renamed(one: Readings) -> Readings:
        if not one.of_tool:
            return one
        names = [renames.get(s.name, s.name) for s in one.setups]
        if len(set(names)) < len(names):
            return one
        setups = zip(one.setups, names, strict=True)
        return replace(one, setups=tuple(replace(s, name=name) for s, name in setups))

    before = [renamed(one) for one in old]
    # A visit begins with a setup that occurs again, so files with common setups come first.
    common = {s.name for one in before if one.of_tool for s in one.setups}
    after = sorted(new, key=lambda c: not (c.of_tool and any(s.name in common for s in c.setups)))
    names = [c.name for c in (*before, *after)]
    if len(set(names)) < len(names):
        before = [replace(c, name=f"old-{k}-{c.name}") for k, c in enumerate(before, start=1)]
        after = [replace(c, name=f"new-{k}-{c.name}") for k, c in enumerate(after, start=1)]
    return before, after


def _unique_setups_by_kind(side: Sequence[Readings]) -> dict[str, str]:
    """Return the names of setups at the tool by kind, for kinds with a single setup."""
    kinds_and_names = {(s.kind, s.name) for c in side if c.of_tool for s in c.setups}
    count = Counter(kind for kind, _ in kinds_and_names)
    return {kind: name for kind, name in kinds_and_names if count[kind] == 1}
