"""Two runs over the same stops, compared by paired differences.

Read `runs.py` first (`compare_runs`), then `difference.py` (`paired_difference`) and `table.py`.
"""
