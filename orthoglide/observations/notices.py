"""Warnings about readings of dials on legs that are unusual, but no errors."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.numerals import compact
from orthoglide.observations.readings import Readings
from orthoglide.observations.schema import SIGMAS, TEMPERATURE, TIME

STILL_DIAL_STEPS = 2 - 1e-6
"""Steps of the dial: below this spread in every setup, the dial is considered still."""

ZERO_READING = 1e-8
"""Readings below this are zeros of a simulated perfect machine, metres."""

_USUAL_GAUGES = (0.25, 0.5)
"""Shares of L at which the papers place their dials."""

_RULER_TOLERANCE = 1e-4
"""Metres: precision to which people give such places."""


def notices(campaign: Readings, machine: MachineFile) -> Iterator[Note]:
    """Yield the warnings about a campaign of dials on legs."""
    yield from _note_gauges_with_r(campaign, machine)
    yield from _note_still_dial(campaign, machine)
    yield from _note_partly_recorded(campaign)


def _note_gauges_with_r(campaign: Readings, machine: MachineFile) -> Iterator[Note]:
    length, r = machine.geometry.L, machine.geometry.r
    gauge = np.array([place for s in campaign.setups for place in s.gauges])
    excess = gauge[:, None] - np.multiply(_USUAL_GAUGES, length)
    if r > _RULER_TOLERANCE and (np.abs(excess - r) <= _RULER_TOLERANCE).any(axis=1).all():
        places = " and ".join(compact(place * 1e3, 6) for place in np.unique(gauge))
        yield Note(
            f"gauge_mm is {places} mm, which is half or a quarter of L with r = {r * 1e3:g} mm "
            "added: it is counted with r removed, as commands are; take r away unless the dials "
            "do stand there",
            "gauge",
        )


def _note_still_dial(campaign: Readings, machine: MachineFile) -> Iterator[Note]:
    read = np.isfinite(campaign.reading) & campaign.which(lambda s: s.observation.from_datum)
    if not read.any():
        return
    spans = [
        np.ptp(campaign.reading[read & (campaign.setup == index)])
        for index in np.unique(campaign.setup[read])
    ]
    # Rounding and touching make a still dial vary by up to two steps.
    if max(spans) < max(STILL_DIAL_STEPS * machine.dial.resolution, ZERO_READING):
        yield Note(
            f"no setup's readings move by more than {max(spans) * 1e3:.3g} mm: is the dial "
            "touching the leg? Unless the machine is as good as that, such readings say nothing",
            "reading",
        )


def _note_partly_recorded(campaign: Readings) -> Iterator[Note]:
    consequences = {
        TIME: "these count as taken at the start",
        TEMPERATURE: "these count as no warmer than the first",
        SIGMAS["mm"]: "these take the dial's",
    }
    for column, consequence in consequences.items():
        absent = np.isnan(getattr(campaign, column.attribute))
        if absent.any() and not absent.all():
            text = f"{column.name} is empty in {absent.sum()} of {len(absent)} rows: {consequence}"
            yield Note(text, column.name, tuple(campaign.line[absent].tolist()))
