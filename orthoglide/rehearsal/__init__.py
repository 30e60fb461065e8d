"""Rehearsal: how often a sheet finds what is wrong with machines of one's own dimensions."""

from orthoglide.rehearsal.outcome import Outcome as Outcome
from orthoglide.rehearsal.rehearsing import rehearse as rehearse
from orthoglide.rehearsal.table import Rehearsal as Rehearsal
from orthoglide.rehearsal.weak_spots import WeakSpot as WeakSpot
