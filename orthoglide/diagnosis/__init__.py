"""Diagnosis: faults of the data, what changed, and whether anything is left."""
