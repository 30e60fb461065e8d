"""At the machine: the conversation while it is measured."""

from orthoglide.measuring.record import Record as Record
from orthoglide.measuring.schedule import (
    MAX_READINGS as MAX_READINGS,
    SETTLED_CRITERION as SETTLED_CRITERION,
    opening_sheet as opening_sheet,
)
from orthoglide.measuring.session import Session as Session, SessionEnd as SessionEnd
