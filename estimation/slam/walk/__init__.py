"""Trajectory SLAM: all stops of a walk together, or stop by stop during the walk.

Read `trajectory.py` first; then `modes.py`, `alternation.py`, `smoother.py` and `linearise.py`. `filter.py`
works online.
"""
