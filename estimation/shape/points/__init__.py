"""Contours where only incidence points are known: marginalised contours and straight or recessed walls.

Read `methods.py` first; then `mic.py` for pillars and `line.py` for walls.
"""
