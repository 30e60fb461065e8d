"""From readings to causes: the loop is closed, and what was found becomes a result."""

from orthoglide.closing.fill import build_result as build_result
from orthoglide.closing.loop import compute_outcome as compute_outcome
from orthoglide.closing.outcome import RunOutcome as RunOutcome
