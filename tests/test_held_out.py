"""Files of printers, looked for after the methods were made: readings that were not used."""

from __future__ import annotations

import numpy as np

from benchmarks.held_out import DATA, every, table


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
    assert f"of {len(found)} better than the base" in list(table(found))[-1]
