"""Figures of scenes, campaigns and studies.

Read `plan.py` first; `path_lines.py` and `bands.py` serve several figures.
"""
