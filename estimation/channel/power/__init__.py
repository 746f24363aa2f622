"""Paths from beam powers over delay: no phase between beams is needed.

Read `paths.py` first, then `detect.py` and `beams.py`.
"""
