"""Campaigns in the formats of other tools, in and out.

Read `formats.py` first (out); `measurement_import.py` and `deepmimo_import.py` read.
"""
