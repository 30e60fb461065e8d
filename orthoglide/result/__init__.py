"""What a run found: one typed value for every command, from which reports only read."""

from orthoglide.result.causes import Cause, Explanation
from orthoglide.result.result import Result, Word, by_lack_of_fit
from orthoglide.result.workspace import Workspace

__all__ = ["Cause", "Explanation", "Result", "Word", "Workspace", "by_lack_of_fit"]
