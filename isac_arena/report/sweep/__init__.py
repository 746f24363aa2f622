"""The report of a sweep: one HTML file.

Read `results.py` first (`SweepResults`), then `figures.py`, `captions.py` and `page.py` (`render_sweep`).
"""
