"""The report of a campaign: one HTML file.

Read `html.py` first (`render_report`), then `figures.py` (`make_figures`) and `tables.py`. `payload/` is the data
of the page (`report_payload`), `assets/` its script and style sheets.
"""
