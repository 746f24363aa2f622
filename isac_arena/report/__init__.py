"""Figures and HTML pages: the only package that plots.

Read `style.py` first (`new_figure`, `styled`, `png_bytes`). `figures/` draws, `page/` makes the report of a
campaign (`render_report`), `view/` the 3-D view (`view_page`), `sweep/` the report of a sweep (`render_sweep`).
"""
