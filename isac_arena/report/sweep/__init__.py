"""The report of a sweep: one HTML file.

Read `page.py` first; `results.py` is what the sweep says, `figures.py` draws it.
"""
