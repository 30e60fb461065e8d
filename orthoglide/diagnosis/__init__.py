"""Diagnosis: is anything left, which cause explains it, and which cannot be told apart."""

from orthoglide.diagnosis.candidates import Candidate
from orthoglide.diagnosis.ranking import Rival, Round, Trial, budget, look, refit, rivals, try_out
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.diagnosis.significance import Detection

__all__ = [
    "Candidate",
    "Detection",
    "Rival",
    "Round",
    "Signatures",
    "Trial",
    "budget",
    "look",
    "refit",
    "rivals",
    "signatures",
    "try_out",
]
