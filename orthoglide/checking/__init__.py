"""Two states of one machine, compared by their readings."""

from orthoglide.checking.comparing import Check as Check, check as check
from orthoglide.checking.states import State as State, read_states as read_states
