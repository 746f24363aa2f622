"""SLAM with heights, for channel estimates with elevations.

Read `snapshot.py` first, then `problem.py` and `hypotheses.py`; `trajectory.py` solves all stops of a walk
together.
"""
