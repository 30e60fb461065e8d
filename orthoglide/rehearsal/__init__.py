"""Rehearsal: how often a sheet finds what is wrong with machines of one's own dimensions."""

from orthoglide.rehearsal.outcome import Rehearsal as Rehearsal
from orthoglide.rehearsal.rehearsing import rehearse as rehearse
