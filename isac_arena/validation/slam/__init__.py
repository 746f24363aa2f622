"""Checks of mapping and SLAM.

Read `snapshot.py` first, then `trajectory.py`, `laws.py` and `measured.py`; `trials.py` holds what they share and
`../scenarios/` makes the halls.
"""
