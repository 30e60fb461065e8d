"""What a run found: one typed value for every command, from which reports only read."""

from orthoglide.result.result import Result, Word
from orthoglide.result.workspace import Workspace
