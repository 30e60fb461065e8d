"""At the machine: the conversation while it is measured."""

from orthoglide.measuring.record import Record as Record
from orthoglide.measuring.session import Session as Session
