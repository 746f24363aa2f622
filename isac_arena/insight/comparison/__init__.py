"""Two runs over the same stops, compared pair by pair.

Read `runs.py` first, then `difference.py`.
"""
