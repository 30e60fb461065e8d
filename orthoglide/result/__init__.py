"""What a run found: one typed value for every command, from which reports only read."""

from orthoglide.result.result import Result as Result, Word as Word
from orthoglide.result.workspace import Workspace as Workspace
