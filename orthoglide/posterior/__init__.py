"""Everything known is one posterior: the background, what stands out of it, and free places."""

from orthoglide.posterior.budget import BudgetItem as BudgetItem, budget as budget
from orthoglide.posterior.causes import (
    CandidateScore as CandidateScore,
    Cause as Cause,
    Curve as Curve,
    Explanation as Explanation,
    Located as Located,
    Outstanding as Outstanding,
)
from orthoglide.posterior.columns import with_everything as with_everything
from orthoglide.posterior.everything import (
    FullPosterior as FullPosterior,
    full_posterior as full_posterior,
)
from orthoglide.posterior.free import places_of as places_of
from orthoglide.posterior.levels import check_levels as check_levels
from orthoglide.posterior.outstanding import outstanding as outstanding
from orthoglide.posterior.remains import remains as remains
