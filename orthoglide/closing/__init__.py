"""A run from readings to causes, and its outcome as a result."""

from orthoglide.closing.actions import next_measurements as next_measurements
from orthoglide.closing.fill import build_result as build_result
from orthoglide.closing.loop import compute_outcome as compute_outcome
from orthoglide.closing.outcome import RunOutcome as RunOutcome
