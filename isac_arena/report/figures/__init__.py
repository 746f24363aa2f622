"""Figures of scenes, campaigns and studies.

Read `plan.py` first (`draw_plan`); `path_lines.py` and `bands.py` serve several figures. Every other file has
functions `..._figure` that return a matplotlib figure.
"""
