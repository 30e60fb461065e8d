"""What Python passes in and cannot be meant is refused, with what would be right."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import orthoglide as og

WORN = og.Machine.nominal().with_parameters({"joint_offset.x": 6e-4, "leg_length.y": 5e-5})
DIALS = og.simulate(WORN, "standard", noise=5e-6, seed=1)
POINTS = og.simulate_tcp(WORN, 20, seed=1)


def cases(*given: tuple[str, Callable[[], Any], str]) -> pytest.MarkDecorator:
    """By their name: what is called, and the words with which it is refused."""
    calls = [(call, words) for _, call, words in given]
    return pytest.mark.parametrize(("call", "words"), calls, ids=[name for name, *_ in given])


def refused(call: Callable[[], Any], words: str) -> None:
    with pytest.raises(og.InputError, match=words):
        call()


def fit(given: Any = DIALS, **options: Any) -> og.Estimate:
    return og.identify(given, **options)


@cases(
    ("method", lambda: fit(method="reduced"), "no method 'reduced': .* auto, nlp, nested"),
    ("weighting", lambda: fit(weighting="deviation"), "one of readings, deviations"),
    ("frame", lambda: fit(frame="foo"), "no frame 'foo': it is one of none, translation, rigid"),
    ("frame of points", lambda: fit(POINTS, frame="foo"), "one of none, translation, rigid"),
    ("frame of a loop", lambda: og.close_loop(DIALS, frame="foo"), "one of none"),  # type: ignore[arg-type]
    ("bounds", lambda: fit(bounds={"joint_ofset": 1e-5}), "no free parameter 'joint_ofset': .*_l"),
    ("free", lambda: fit(free="joint_offset"), r"free is a list of names: give \['joint_offset'\]"),
    ("own", lambda: fit(own="joint_offset"), "own is a list of names"),
    ("effects", lambda: og.smallest_effects(WORN, DIALS, names=["foo"]), "no effect 'foo': the"),
    ("an effect", lambda: og.smallest_effects(WORN, DIALS, names="axis_tilt"), "names is a list"),
    ("designed", lambda: og.design(WORN, free="leg_length"), "free is a list of names"),
    ("a count", lambda: og.design(WORN, count=12.5), "ask for 12, not 12.5"),  # type: ignore[arg-type]
    ("a method for dials", lambda: fit([DIALS, POINTS], method="reduction"), "predicts dials only"),
)
def test_misspelt_options(call: Callable[[], Any], words: str) -> None:
    refused(call, words)


def test_bounds_of_what_is_free_hold() -> None:
    found = fit(bounds={"joint_offset": 1e-5, "leg_length.x": 1e-3})
    assert max(abs(found.values[f"joint_offset.{leg}"]) for leg in "xyz") < 1.1e-5


def test_smallest_effects_of_one_parameter() -> None:
    found = og.smallest_effects(WORN, DIALS, names=["axis_tilt.y.z"])
    assert {s.effect for s in found.smallest} == {"axis_tilt"}
    assert {s.name for s in found.smallest if s.elementary} == {"axis_tilt.y.z"}


def test_figures_are_svg(tmp_path: Path) -> None:
    refused(lambda: fit().plot().save(tmp_path / "a.png"), "ends in .svg")
    assert not list(tmp_path.iterdir())
