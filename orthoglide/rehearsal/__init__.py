"""Rehearsal: how often a sheet finds what is wrong with machines of one's own dimensions."""

from orthoglide.rehearsal.rehearsing import rehearse as rehearse
from orthoglide.rehearsal.table import Rehearsal as Rehearsal
