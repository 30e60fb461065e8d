"""Everything known is one posterior: the background, what stands out of it, and free places."""

from orthoglide.posterior.causes import (
    CandidateScore,
    Cause,
    Curve,
    Explanation,
    Located,
    Outstanding,
)
from orthoglide.posterior.everything import FullPosterior, full_posterior
from orthoglide.posterior.outstanding import outstanding

__all__ = [
    "CandidateScore",
    "Cause",
    "Curve",
    "Explanation",
    "FullPosterior",
    "Located",
    "Outstanding",
    "full_posterior",
    "outstanding",
]
