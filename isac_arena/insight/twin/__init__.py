"""The digital twin of a measured hall: measured paths explained by simulated ones.

Read `twin.py` first (`make_twin`), then `explain.py` (`explain_paths`), `offsets.py`, `power.py` and `scores.py`
(`twin_metrics`).
"""
