"""The result of a run as plain values.

The search (`orthoglide.closing`) fills it, ``result.json`` contains it, and everything else reads
it: reports, figures, the command line. Nothing here depends on how the values were found.

A new value takes four steps: a field with its type and description in `Result` or one of its parts,
its computation in ``closing/fill.py``, a line in the table of ``docs/files.md``, and, if earlier
results are to be read without it, a default.
"""

from orthoglide.result.codec import decoded as decoded, encoded as encoded
from orthoglide.result.display import (
    Action as Action,
    Mounting as Mounting,
    ReadingsShown as ReadingsShown,
    Suspect as Suspect,
    Workspace as Workspace,
)
from orthoglide.result.findings import (
    CandidateScore as CandidateScore,
    Cause as Cause,
    Curve as Curve,
    DataRival as DataRival,
    Explanation as Explanation,
    Located as Located,
)
from orthoglide.result.fits import (
    BudgetItem as BudgetItem,
    Change as Change,
    DataFault as DataFault,
    HoldOut as HoldOut,
    LackOfFit as LackOfFit,
    SetupResidual as SetupResidual,
    TcpErrors as TcpErrors,
    WeakDirection as WeakDirection,
)
from orthoglide.result.request import (
    Command as Command,
    Request as Request,
    read_result as read_result,
    request_of as request_of,
)
from orthoglide.result.result import Result as Result, Word as Word
