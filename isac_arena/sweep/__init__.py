"""Many campaigns: cases of a design, run on many processes.

Read `plan.py` first, then `cases.py`, `run.py` (one case) and `engine.py` (many, by dask).
"""
