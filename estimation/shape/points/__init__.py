"""Contours from incidence points only: marginalised contours, and straight or recessed walls.

Read `methods.py` first; then `mic.py` for pillars and `line.py` for walls.
"""
