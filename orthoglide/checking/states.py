"""Two states of one machine, each as its readings, or as a result that keeps them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from orthoglide.effects import Effect
from orthoglide.errors import InputError
from orthoglide.files import inside
from orthoglide.fit import readings_of
from orthoglide.machine import Machine
from orthoglide.observations import Given, Readings
from orthoglide.result.reading import read_result, request_of
from orthoglide.result.request import Request

State = Given | Sequence[Given] | Request
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


def states_of(
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
    runs = [_as_run(state, effects) for state in (old, new)]
    kept = next((run.machine for run in runs if isinstance(run, Request)), None)
    kept = kept or Machine.nominal().with_effects(effects)
    (machine, before), (other, after) = (
        _state(run, state, given, kept) for run, state in zip(runs, (old, new), strict=True)
    )
    one, two = _called(old, before), _called(new, after)
    _check_numbers(one, machine, two, other)
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


def _as_run(state: State, effects: tuple[Effect, ...]) -> State:
    """The run whose result stands at a path; other states as they are."""
    if not isinstance(state, str | os.PathLike):
        return state
    path = Path(state)
    if path.suffix == ".toml":
        raise InputError(
            f"{path} is a machine file, which has no readings: give the result.json beside "
            f"it, or the campaign"
        )
    path = inside(path, "result.json")
    return request_of(read_result(path), str(path), effects) if path.suffix == ".json" else state


def _state(
    run: State, state: State, given: Machine | None, otherwise: Machine
) -> tuple[Machine, tuple[Readings, ...]]:
    """The machine by which a state's readings are read, and these."""
    if isinstance(run, Request):
        if given is not None:
            called = _called(state, run.readings)
            _check_numbers(called, run.machine, given.spec.file or "the machine", given)
        return given or run.machine, run.readings
    machine = given or otherwise
    return machine, readings_of(run, machine)


def _called(state: State, readings: Sequence[Readings]) -> str:
    """What a state is called in messages: by its path, else by its readings."""
    named = isinstance(state, str | os.PathLike)
    return str(state) if named else ", ".join(r.name for r in readings)


def _check_numbers(one: str, machine: Machine, two: str, other: Machine) -> None:
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
