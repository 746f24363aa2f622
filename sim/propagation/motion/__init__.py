"""Paths that change while a sweep lasts.

Read `rates.py` first: the exact rates of length and directions of every path. `bounces.py` gives the surface
around each interaction that they need. `sweep.py` traces a sweep, `tracks.py` holds its paths over its time.
"""
