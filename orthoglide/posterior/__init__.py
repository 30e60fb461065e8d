"""Everything known is one posterior: the background, what stands out of it, and free places."""

from orthoglide.posterior.everything import FullPosterior, full_posterior

__all__ = ["FullPosterior", "full_posterior"]
