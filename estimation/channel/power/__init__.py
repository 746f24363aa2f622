"""Paths from beam powers over delay; no phase between beams is needed.

Read `paths.py` first (`estimate_power`), then `detect.py` and `beams.py`.
"""
