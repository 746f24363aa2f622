"""Checks of object shapes.

Read `reflection.py` first; the data come from `validation.scenarios`.
"""
