"""Checks of object shapes.

Read `reflection.py` first; `reflection_scenarios.py` and `point_clusters.py` make the data.
"""
