"""Two states of one machine, each as its readings or a result that keeps them, and as requests."""

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
from orthoglide.result.loading import read_result, request_of
from orthoglide.result.request import Request

State = ReadingsOrPath | Sequence[ReadingsOrPath] | Request
"""Readings, or a run that has them; of its result the path of ``result.json`` or of its folder."""


@dataclass(frozen=True)
class States:
    """One machine and its readings in two states."""

    machine: Machine  # by which all are read
    old: tuple[Readings, ...]
    new: tuple[Readings, ...]
    # standard deviation of a reading, metres: the larger that results were computed with; absent
    # where none was declared
    noise: float | None


def read_states(
    old: State, new: State, given: Machine | None = None, effects: tuple[Effect, ...] = ()
) -> States:
    """Return the machine and the readings of both states.

    Args:
        old: the state before.
        new: the state after.
        given: the machine by which all are read; where absent a result's own, of readings that of
            the other state, else the nominal one.
        effects: of a user's own, for machines that are read.

    Raises:
        InputError: where a side has no readings, or the two are of different machines.
    """
    runs = [_load_run(state, effects) for state in (old, new)]
    kept = next((run.machine for run in runs if isinstance(run, Request)), None)
    kept = kept or Machine.nominal().with_effects(effects)
    (machine, before), (other, after) = (
        _machine_and_readings(run, state, given, kept)
        for run, state in zip(runs, (old, new), strict=True)
    )
    one, two = _state_name(old, before), _state_name(new, after)
    _check_firmware_numbers(one, machine, two, other)
    if other.geometry != machine.geometry:
        raise InputError(
            f"{one} and {two} are of machines of different dimensions "
            f"({machine.spec.title}; {other.spec.title}): check compares two states of one; "
            f"where the file was corrected since, and no number that the controller counts "
            f"with, give it for both with --machine (machine=); what other numbers of a controller "
            f"left, close-loop tells from the new readings"
        )
    declared = [run.noise for run in runs if isinstance(run, Request) and run.noise is not None]
    return States(machine, before, after, max(declared, default=None))


def _load_run(state: State, effects: tuple[Effect, ...]) -> State:
    """The run whose result stands at a path; other states as they are."""
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


def _machine_and_readings(
    run: State, state: State, given: Machine | None, otherwise: Machine
) -> tuple[Machine, tuple[Readings, ...]]:
    """The machine by which a state's readings are read, and these."""
    if isinstance(run, Request):
        if given is not None:
            called = _state_name(state, run.readings)
            _check_firmware_numbers(called, run.machine, given.spec.file or "the machine", given)
        return given or run.machine, run.readings
    machine = given or otherwise
    return machine, readings_of(run, machine)


def _state_name(state: State, readings: Sequence[Readings]) -> str:
    """What a state is called in messages: by its path, else by its readings."""
    named = isinstance(state, str | os.PathLike)
    return str(state) if named else ", ".join(r.name for r in readings)


def _check_firmware_numbers(one: str, machine: Machine, two: str, other: Machine) -> None:
    """Refuses two imports with other numbers of the firmware: equal commands are no equal heights
    of the carriages, and what was pasted would be told as what changed.
    """
    marks = machine.spec.firmware, other.spec.firmware
    if all(marks) and marks[0] != marks[1]:
        raise InputError(
            f"{one} was imported with other numbers of the firmware ({marks[0]}) than {two} "
            f"({marks[1]}): check compares two states under the same numbers; what the numbers "
            f"changed between the visits left, close-loop tells from the new readings with the "
            f"machine.toml of their import"
        )


def joint_request(
    machine: Machine,
    before: Sequence[Readings],
    after: Sequence[Readings],
    noise: float | None,
    seed: int,
) -> tuple[Request, bool]:
    """The request of both states, and whether it lacks readings of the old one: a fit has the dials
    first and takes the tool's readings for those of the last state.
    """
    dials = tuple(r for r in (*before, *after) if not r.of_tool)
    tool = [r for r in (*before, *after) if r.of_tool]
    past = [r for r in before if r in tool and any(d in after for d in dials)]
    points = tuple(r for r in tool if r not in past)
    request = Request("close-loop", dials, machine, (), noise, seed, points=points)
    return request, bool(past)


def single_request(request: Request, side: Sequence[Readings]) -> Request:
    """The request of one state alone."""
    dials = tuple(r for r in side if not r.of_tool)
    return replace(request, campaigns=dials, points=tuple(r for r in side if r.of_tool))


def with_distinct_names(
    old: Sequence[Readings], new: Sequence[Readings]
) -> tuple[list[Readings], list[Readings]]:
    """The campaigns of both sides, no two of one name; an instrument at the tool that is the only
    one of its kind at both visits has one name at both.
    """
    now, then = (_unique_setups_by_kind(side) for side in (new, old))
    called = {name: now[kind] for kind, name in then.items() if kind in now}

    def renamed(one: Readings) -> Readings:
        if not one.of_tool:
            return one
        names = [called.get(s.name, s.name) for s in one.setups]
        if len(set(names)) < len(names):
            return one
        setups = zip(one.setups, names, strict=True)
        return replace(one, setups=tuple(replace(s, name=name) for s, name in setups))

    old = [renamed(one) for one in old]
    # What both visits read comes first in the new one: there the files of a visit begin anew.
    known = {name for one in old for name in _tool_setup_names(one)}
    new = sorted(new, key=lambda one: known.isdisjoint(_tool_setup_names(one)))
    names = [c.name for c in (*old, *new)]
    if len(set(names)) == len(names):
        return list(old), list(new)
    sides = ((old, "old"), (new, "new"))
    before, after = (
        [replace(c, name=f"{side}-{k}-{c.name}") for k, c in enumerate(several, start=1)]
        for several, side in sides
    )
    return before, after


def _tool_setup_names(one: Readings) -> list[str]:
    """Names of the setups at the tool, none of dials on legs."""
    return [s.name for s in one.setups] if one.of_tool else []


def _unique_setups_by_kind(side: Sequence[Readings]) -> dict[str, str]:
    """Names of setups at the tool by their kind, where there is one of it."""
    named = {(s.kind, s.name) for c in side if c.of_tool for s in c.setups}
    count = Counter(kind for kind, _ in named)
    return {kind: name for kind, name in named if count[kind] == 1}
