"""At the machine: the conversation while it is measured."""

from orthoglide.measuring.record import Record as Record
from orthoglide.measuring.session import (
    MAX_READINGS as MAX_READINGS,
    SETTLED_CRITERION as SETTLED_CRITERION,
    Session as Session,
    SessionEnd as SessionEnd,
    opening_sheet as opening_sheet,
)
