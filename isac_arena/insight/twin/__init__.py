"""The digital twin of a measured hall: simulated paths beside measured ones.

Read `twin.py` first, then `explain.py` and `scores.py`.
"""
