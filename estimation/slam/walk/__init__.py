"""Trajectory SLAM: all stops of a walk together, or stop by stop as the walk goes on.

Read `trajectory.py` first; then `modes.py`, `alternation.py`, `smoother.py` and `linearise.py`. `filter.py`
works online.
"""
