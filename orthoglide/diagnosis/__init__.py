"""Diagnosis: faults of the data, what changed, and whether anything is left."""

from orthoglide.diagnosis.candidates import Candidate
from orthoglide.diagnosis.signatures import Signatures, signatures
from orthoglide.diagnosis.significance import Left, left_over
