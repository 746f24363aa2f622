"""Antenna arrays and their beams.

Read `array.py` first (element positions and steering vectors), then `beams.py` and `codebook.py`.
"""
