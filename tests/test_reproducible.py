"""No printed number depends on compiled code, on a cache, on threads or on the sixteenth digit.

Each campaign is closed as it is and once more otherwise, and every number and word of `result.json`
is compared as `orthoglide rerun` does. Dimensions that differ in their last bit change the rounding
of everything that is computed from them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import threadpoolctl

import orthoglide as og
from orthoglide.report import result_text

DATA = Path(__file__).parent / "data"
RIG = DATA / "rig"
PUBLISHED = Path(og.__file__).parent / "data" / "experiment2.csv"
# What was given, how many steps it took, checks that measure rounding, and the machine as a text of
# all digits, whose numbers are those of `calibrated`.
APART = ("version", "inputs", "machine", "method", "verification", "calibrated_machine")

Close = Callable[[og.Machine], og.Verdict]


def rig(*numbers: int) -> tuple[og.Machine, Close]:
    machine = og.Machine.load(RIG / "machine.toml")
    files = [RIG / f"rig-{k}.csv" for k in numbers]
    return machine, lambda given: og.close_loop(files, given)


def published() -> tuple[og.Machine, Close]:
    return og.Machine.nominal(), lambda given: og.close_loop(PUBLISHED, given)


def delta() -> tuple[og.Machine, Close]:
    """Near-degenerate weak directions, of which rounding chose the basis."""
    imported = og.import_printer(DATA / "delta" / "electrocally.cfg")
    campaigns = imported.campaigns
    return og.Machine(imported.machine), lambda given: og.close_loop(campaigns[1:], given)


@cache
def exact() -> tuple[og.Machine, Close]:
    """Readings without noise of a machine without errors: all legs are equal, and nothing is left
    of the readings but rounding.
    """
    machine = og.Machine.load(RIG / "machine.toml")
    campaign = og.simulate(machine, og.protocol("standard"), seed=0, exact=True)
    return machine, lambda given: og.close_loop(campaign, og.Machine(given.spec))


CASES = {
    "delta": delta,
    "published": published,
    "rig-2": lambda: rig(2),
    "rig-2 and rig-3": lambda: rig(2, 3),  # causes under two names, equally likely
    "exact": exact,
}


def numbers(name: str, bits: int = 0) -> dict[str, Any]:
    """What `result.json` holds of a case, with dimensions so many bits larger."""
    machine, close = CASES[name]()
    if bits:
        old = machine.geometry
        L, d, r = (value * (1 + bits * np.finfo(float).eps) for value in (old.L, old.d, old.r))
        assert L != old.L
        machine = og.Machine(replace(machine.spec, geometry=replace(old, L=L, d=d, r=r)))
    found = json.loads(result_text(close(machine)))
    return {key: value for key, value in found.items() if key not in APART}


@cache
def usual(name: str) -> dict[str, Any]:
    """The same by compiled code from the cache, where there is a compiler."""
    machine, _ = CASES[name]()
    machine.forward(np.tile(machine.geometry.zero, (25_000, 1)))  # leaves a copy in the cache
    return numbers(name)


# --- Comparison of two results as decoded JSON: equal but for rounding ---------------------------

SAME, TINY = 1e-6, 1e-9  # relative, and in the units of files: what processors round otherwise
OF_SOLVERS = ("iterations", "last_step_in_sigmas")  # of any fit


def leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of a nested mapping with the place where it stands."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from leaves(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            yield from leaves(inner, f"{place}[{k}]")
    else:
        yield place, value


def differences(old: Any, new: Any) -> Iterator[str]:
    """Where two results differ by more than rounding."""
    before, after = (
        {place: one for place, one in leaves(every) if not place.endswith(OF_SOLVERS)}
        for every in (old, new)
    )
    for place in dict.fromkeys((*before, *after)):
        one, other = before.get(place, "gone"), after.get(place, "gone")
        if not alike(one, other):
            yield f"{place} was {one!r} and is {other!r}"


def alike(one: Any, other: Any) -> bool:
    """Whether two values are equal, numbers to rounding or as neighbours of six digits."""
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in (one, other)):
        return bool(one == other)
    if math.isclose(one, other, rel_tol=SAME, abs_tol=TINY):
        return True
    if any(float(f"{v:.6g}") != v or v == 0 for v in (one, other)):
        return False
    digit = 10.0 ** (math.floor(math.log10(min(abs(one), abs(other)))) - 5)
    return bool(abs(one - other) < 1.5 * digit)


def same(one: dict[str, Any], other: dict[str, Any]) -> None:
    assert not list(differences(one, other))
    values = one["after"].values()
    assert any(isinstance(v, float) and math.isfinite(v) for v in values)


@pytest.mark.thorough
@pytest.mark.parametrize("otherwise", ["interpreted", "last bit", "cold cache", "threads"])
@pytest.mark.parametrize("name", CASES)
def test_numbers_do_not_depend_on(
    name: str, otherwise: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A cold cache changes from interpreted to compiled code in the middle of a run."""
    first, bits = usual(name), int(otherwise == "last bit")
    if otherwise == "interpreted":
        monkeypatch.setenv("ORTHOGLIDE_COMPILE", "0")
    elif otherwise == "cold cache":
        monkeypatch.setenv("ORTHOGLIDE_CACHE", str(tmp_path))
    with threadpoolctl.threadpool_limits(2 if otherwise == "threads" else 1, user_api="blas"):
        same(first, numbers(name, bits))


@pytest.mark.parametrize("method", ["nlp", "nested"])
def test_fits_end_at_the_minimum(method: Literal["nlp", "nested"]) -> None:
    """Up to rounding, so that no digit depends on where a solver's own tolerance was met."""
    imported = og.import_printer(DATA / "delta" / "electrocally.cfg")
    heights = imported.campaigns[0]
    found = [og.identify(PUBLISHED, method=method)]
    if method == "nested":
        found.append(og.identify(heights, imported.machine, method=method))
    for estimate in found:
        assert estimate.method == method
        assert estimate.optimality < 1e-9
