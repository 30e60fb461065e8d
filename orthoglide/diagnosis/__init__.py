"""Diagnosis: is anything left, which cause explains it, and which cannot be told apart."""

from orthoglide.diagnosis.candidates import Candidate
from orthoglide.diagnosis.ranking import (
    CandidateFit,
    Diagnosis,
    Rival,
    budget,
    diagnose,
    fit_candidates,
    refit,
    rivals,
)
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.diagnosis.significance import Detection

__all__ = [
    "Candidate",
    "CandidateFit",
    "Detection",
    "Diagnosis",
    "Rival",
    "Signatures",
    "budget",
    "diagnose",
    "fit_candidates",
    "refit",
    "rivals",
    "signatures",
]
