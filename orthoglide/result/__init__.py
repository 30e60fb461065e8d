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
    Picture as Picture,
    Proposal as Proposal,
    ReadingsShown as ReadingsShown,
    Suspect as Suspect,
    Withheld as Withheld,
    Workspace as Workspace,
)
from orthoglide.result.findings import (
    CandidateScore as CandidateScore,
    Cause as Cause,
    Curve as Curve,
    DataRival as DataRival,
    Explanation as Explanation,
    Located as Located,
    Possible as Possible,
)
from orthoglide.result.fits import (
    BudgetItem as BudgetItem,
    Change as Change,
    DataFault as DataFault,
    Fit as Fit,
    HoldOut as HoldOut,
    Identified as Identified,
    LackOfFit as LackOfFit,
    Noise as Noise,
    Scores as Scores,
    SetupNoise as SetupNoise,
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
from orthoglide.result.result import (
    Judged as Judged,
    Result as Result,
    Unseen as Unseen,
    Word as Word,
)
