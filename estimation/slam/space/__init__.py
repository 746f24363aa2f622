"""SLAM with heights, for channel estimates with elevations.

Read `snapshot.py` first, then `problem.py` and `hypotheses.py`; `trajectory.py` takes all stops together.
"""
