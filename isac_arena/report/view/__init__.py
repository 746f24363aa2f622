"""The 3-D view of a campaign: one HTML file.

Read `page.py` first (`view_page`), then `traces.py`.
"""
