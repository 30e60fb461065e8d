"""Two states of one machine, given as readings or as results, and their requests."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from orthoglide.effects import Catalogue, Effect, catalogue_of
from orthoglide.effects.bumps_and_jumps import with_free_forms
from orthoglide.errors import InputError
from orthoglide.files import result_file
from orthoglide.fit import readings_of
from orthoglide.machine import Machine
from orthoglide.observations import Readings, ReadingsOrPath
from orthoglide.observations.tables import with_distinct_sources
from orthoglide.result.request import Request, read_result, request_of

State = ReadingsOrPath | Sequence[ReadingsOrPath] | Request
"""Readings, a request, or the path of a ``result.json`` or of its folder."""


def read_states(
    old: State, new: State, given: Machine | None = None, effects: tuple[Effect, ...] = ()
) -> tuple[Request, Request]:
    """Return both states as requests of one machine.

    Args:
        old: the state before.
        new: the state after.
        given: the machine of both states; by default that of a result, otherwise the nominal one.
        effects: user-defined effects of machines that are loaded.

    Raises:
        InputError: if a side has no readings, or the two are of different machines.
    """
    loaded = [_load_run(state, effects) for state in (old, new)]
    of_results = (state.machine for state in loaded if isinstance(state, Request))
    default = given or next(of_results, Machine.nominal().with_effects(effects))
    before, after = (
        Request("close-loop", state.readings, state.machine, (), state.noise)
        if isinstance(state, Request)
        else Request("close-loop", readings_of(state, default), default)
        for state in loaded
    )
    names, machines = ("the old state", "the new state"), (before.machine, after.machine)
    if given is None:
        _check_firmware_numbers(*names, *machines)
    else:
        for name, machine in zip(names, machines, strict=True):
            _check_firmware_numbers(name, given.spec.file or "the machine", machine, given)
        before, after = (replace(request, machine=given) for request in (before, after))
    if before.machine.geometry != after.machine.geometry:
        raise InputError(
            f"the two states have different dimensions ({before.machine.spec.title}; "
            f"{after.machine.spec.title}), and check compares one machine with itself. If only the "
            f"description was corrected, give the corrected file for both with --machine "
            f"(machine=); if the controller uses new numbers, run close-loop on the new readings"
        )
    machine = _before_calibration(before.machine)
    return replace(before, machine=machine), replace(after, machine=machine)


def _before_calibration(machine: Machine) -> Machine:
    """Return the machine without the parameters, posterior and located errors of an earlier run,
    and without the warning that the posterior is missing.

    Otherwise the old readings would count twice, as prior and as data, and a located error would be
    compared by its coefficients in place of its size.
    """
    spec = machine.spec
    if "verdict" not in spec.provenance:
        return machine
    catalogue = catalogue_of(spec.catalogue.legs)
    located = {*with_free_forms(catalogue, spec.catalogue, spec.geometry)} - {*catalogue}
    remaining = tuple(e for e in spec.catalogue.effects if e.name not in located)
    catalogue = Catalogue(remaining, spec.catalogue.legs)
    warnings = tuple(note for note in spec.warnings if note.kind != "covariance")
    spec = replace(spec, catalogue=catalogue, parameters={}, posterior=None, warnings=warnings)
    return Machine(spec)


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


def _check_firmware_numbers(name: str, other_name: str, machine: Machine, other: Machine) -> None:
    """Refuse two imports with different numbers of the firmware, because equal commands then mean
    different carriage heights, and pasted numbers would be reported as changes.
    """
    marks = machine.spec.firmware, other.spec.firmware
    if all(marks) and marks[0] != marks[1]:
        raise InputError(
            f"{name} was imported with other numbers of the firmware ({marks[0]}) than "
            f"{other_name} ({marks[1]}): check compares two states under the same numbers; run "
            f"close-loop on the new readings, with the machine.toml of their import"
        )


def with_distinct_names(
    old: Sequence[Readings], new: Sequence[Readings]
) -> tuple[list[Readings], list[Readings]]:
    """Return the campaigns of both sides with distinct names and labels. A setup at the tool that
    is the only one of its kind at both visits gets the same name at both.
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
    # Tables are assigned to visits by the first setup that recurs, so tables with common setups
    # come first.
    common = {s.name for one in before if one.of_tool for s in one.setups}
    after = sorted(new, key=lambda c: not (c.of_tool and any(s.name in common for s in c.setups)))
    names = [c.name for c in (*before, *after)]
    if len(set(names)) < len(names):
        before = [replace(c, name=f"old-{k}-{c.name}") for k, c in enumerate(before, start=1)]
        after = [replace(c, name=f"new-{k}-{c.name}") for k, c in enumerate(after, start=1)]
    labelled = with_distinct_sources((*before, *after))
    return labelled[: len(before)], labelled[len(before) :]


def _unique_setups_by_kind(side: Sequence[Readings]) -> dict[str, str]:
    """Return the names of setups at the tool by kind, for kinds with a single setup."""
    kinds_and_names = {(s.kind, s.name) for c in side if c.of_tool for s in c.setups}
    count = Counter(kind for kind, _ in kinds_and_names)
    return {kind: name for kind, name in kinds_and_names if count[kind] == 1}
