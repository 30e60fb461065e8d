"""Diagnosis: faults of the data, what changed, and whether anything is left."""

from orthoglide.diagnosis.candidates import Candidate as Candidate
from orthoglide.diagnosis.signatures import (
    Signatures as Signatures,
    signatures as signatures,
)
from orthoglide.diagnosis.significance import (
    Left as Left,
    left_over as left_over,
)
