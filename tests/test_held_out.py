"""Files of printers: readings that were not used, and the page of what is told of them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.deltas import page
from benchmarks.held_out import DATA, every, table

PAGE = Path(__file__).parents[1] / "docs" / "real-printers.md"
NUMBER = re.compile(r"(?<![\w.])−?\d+(?:\.\d+)?")


@pytest.mark.thorough
def test_the_page_of_deltas_is_what_its_script_prints() -> None:
    """But for the last digits of its numbers, which differ between processors."""
    remedy = "stale: python -m benchmarks.deltas > docs/real-printers.md"
    written, printed = PAGE.read_text(encoding="utf-8"), page()
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", written), remedy
    old, new = (
        [float(n.replace("−", "-")) for n in NUMBER.findall(text)] for text in (written, printed)
    )
    assert len(new) > 60
    np.testing.assert_allclose(new, old, rtol=0.05, atol=0.011, err_msg=remedy)


@pytest.mark.thorough
def test_what_is_found_predicts_what_was_not_used() -> None:
    found = every([DATA / "held"])
    machines = {one.machine for one in found}
    assert len(machines) == 5
    gain = np.array([one.closed / one.base for one in found])
    assert np.mean(gain < 1) > 0.7
    assert np.median(gain) < 0.95
    assert gain.max() < 1.2
    for name in machines:  # none is the worse for it as a whole
        assert (
            np.mean([np.log(one.closed / one.base) for one in found if one.machine == name]) < 0.1
        )
    kept = [one.closed / one.stored for one in found if one.word == "unexplained"]
    assert len(kept) >= 5
    assert max(kept) < 1.05  # what cannot be explained is not fitted
    assert f"of {len(found)} better than the base" in list(table(found))[-1]
