"""The error budget: which share of the final errors each stage and each piece of physics causes.

Read `runs.py` first, then `chain.py` (stages replaced by truth) and `attribution.py` (shares with intervals).
"""
