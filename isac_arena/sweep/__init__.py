"""Many campaigns: cases of a design, run on many processes.

Read `plan.py` first, then `cases.py`, `run.py` (one case), `engine.py` (many cases) and `runner.py` (the whole
sweep). `report.py` makes the page of `arena sweep-report`.
"""
