"""Contours by the reflection law, from delays and angles of all stops.

Read `fit_all.py` first; then `paths.py`, `objects.py`, `faces`, `choice.py` and `bundle.py`.
"""
