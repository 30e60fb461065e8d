"""Two states of one machine, compared by their readings."""

from orthoglide.checking.comparing import Check as Check, check as check
from orthoglide.checking.difference import COLUMNS as COLUMNS, Difference as Difference
from orthoglide.checking.states import State as State, read_states as read_states
