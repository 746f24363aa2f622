"""The digital twin of a measured hall: measured paths explained by simulated ones.

Read `twin.py` first (`make_twin`), then `explain.py` (`explained`), `offsets.py`, `power.py` and `scores.py`
(`twin_metrics`).
"""
