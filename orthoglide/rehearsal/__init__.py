"""Rehearsal: how often a sheet finds what is wrong with machines of one's own dimensions."""

from orthoglide.rehearsal.outcome import Outcome
from orthoglide.rehearsal.rehearsing import rehearse
from orthoglide.rehearsal.table import Rehearsal
from orthoglide.rehearsal.weak_spots import WeakSpot
