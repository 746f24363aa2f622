"""Snapshot SLAM: pose and clock bias of one stop from its paths alone.

Read `solve.py` first; then `problem.py`, and `reference.py` (as published) or `statistical.py` (ours) with
`hypotheses.py`, `likelihood.py` and `evidence.py`.
"""
