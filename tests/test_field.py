"""Small inputs after public reports on which an earlier version was wrong: see data/field."""

from __future__ import annotations

from pathlib import Path

import pytest

import orthoglide as og

FIELD = Path(__file__).parent / "data" / "field"


def closed(folder: str, file: str) -> og.Verdict:
    """The readings that a printer's file holds, closed."""
    found = og.import_printer(FIELD / folder / file)
    return og.close_loop(found.campaigns, og.Machine(found.machine))


@pytest.mark.parametrize("file", ["real.cfg", "crumb-0.8mm.cfg"])
def test_seven_touches_far_beyond_their_noise_are_unexplained(file: str) -> None:
    verdict = closed("seven-touches-false-adequate", file)
    assert verdict.before.scores.lack_of_fit_p < 1e-6
    assert verdict.word == "unexplained"
    assert "read it again" in verdict.actions[0].words
