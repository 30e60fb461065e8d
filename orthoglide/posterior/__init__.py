"""Everything known is one posterior: the background, what stands out of it, and free places."""

from orthoglide.posterior.budget import BudgetItem, budget
from orthoglide.posterior.causes import (
    CandidateScore,
    Cause,
    Curve,
    Explanation,
    Located,
    Outstanding,
)
from orthoglide.posterior.columns import with_everything
from orthoglide.posterior.everything import FullPosterior, full_posterior
from orthoglide.posterior.free import places_of
from orthoglide.posterior.outstanding import NAMED, outstanding
from orthoglide.posterior.remains import remains
