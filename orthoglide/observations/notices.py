"""Warnings about readings of dials on legs that are unusual, but no errors."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orthoglide.machine_file import MachineFile
from orthoglide.notes import Note
from orthoglide.observations.readings import Readings
from orthoglide.observations.schema import SIGMAS, TEMPERATURE, TIME

STILL_DIAL_STEPS = 2 - 1e-6
"""Steps of the dial: below this spread in every setup, the dial is considered still."""

ZERO_READING = 1e-8
"""Readings below this are zeros of a simulated perfect machine, metres."""


def notices(campaign: Readings, machine: MachineFile) -> Iterator[Note]:
    """Yield the warnings about a campaign of dials on legs."""
    yield from _note_still_dial(campaign, machine)
    yield from _note_partly_recorded(campaign)
    yield from _note_late_clock(campaign)


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


def _note_late_clock(campaign: Readings) -> Iterator[Note]:
    """Note a clock that starts later than the session is long: bars that warm from its zero would
    have grown before the first reading.
    """
    time = campaign.time[np.isfinite(campaign.time)]
    if len(time) and time.min() > np.ptp(time):
        yield Note(
            f"{TIME.name} starts at {time.min():.6g} s: give seconds since the start of the "
            f"session, not a time of day, as effects that grow with time count from 0",
            TIME.name,
        )
