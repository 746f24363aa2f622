"""Checks of mapping and SLAM.

Read `snapshot.py` first, then `trajectory.py`, `spatial.py` and `measured.py`; `scenarios.py` makes the halls.
"""
