"""Figures and HTML pages: the only home of plotting.

`figures/` draws, `page/` makes the report of a campaign, `view/` the 3-D view, `sweep/` the report of a sweep.
"""
