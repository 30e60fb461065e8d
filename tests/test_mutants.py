"""The list of mutants fits the code: `dev.py mutate` breaks each line and runs its tests."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FEWEST = 50
MUTANTS = tomllib.loads((ROOT / "tests" / "mutants.toml").read_text(encoding="utf-8"))["mutant"]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: m["name"])
def test_a_mutant_breaks_one_line_that_a_test_guards(mutant: dict) -> None:
    text = (ROOT / mutant["file"]).read_text(encoding="utf-8")
    assert text.count(mutant["old"]) == 1
    for named in mutant["tests"]:
        file, _, test = named.partition("::")
        assert f"def {test.partition('[')[0]}(" in (ROOT / file).read_text(encoding="utf-8")


def test_there_are_enough_mutants() -> None:
    """Code that is replaced hands on its mutants; see the head of the list."""
    assert len(MUTANTS) >= FEWEST


def test_names_tell_mutants_apart() -> None:
    assert len({m["name"] for m in MUTANTS}) == len(MUTANTS)
