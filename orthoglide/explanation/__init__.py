"""Everything known is one posterior: the background, what stands out of it, and free places."""

from orthoglide.explanation.budget import BudgetItem as BudgetItem, budget as budget
from orthoglide.explanation.causes import (
    CandidateScore as CandidateScore,
    Cause as Cause,
    Curve as Curve,
    Explanation as Explanation,
    Located as Located,
    Outstanding as Outstanding,
)
from orthoglide.explanation.columns import with_everything as with_everything
from orthoglide.explanation.everything import (
    FullPosterior as FullPosterior,
    full_posterior as full_posterior,
)
from orthoglide.explanation.free import places_of as places_of
from orthoglide.explanation.levels import check_levels as check_levels
from orthoglide.explanation.outstanding import outstanding as outstanding
from orthoglide.explanation.remains import remains as remains
