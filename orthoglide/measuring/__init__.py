"""At the machine: the conversation while it is measured."""

from orthoglide.measuring.program import MOST as MOST, SETTLED as SETTLED, opening as opening
from orthoglide.measuring.record import Record as Record
from orthoglide.measuring.session import End as End, Session as Session
