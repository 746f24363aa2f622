"""The report of a campaign: one HTML file.

Read `html.py` first; `payload.py` is what the page knows, `assets/` its script and styles.
"""
