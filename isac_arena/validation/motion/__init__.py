"""Checks of motion: rates of paths and samples of moving worlds against tracing again, and frozen worlds.

`worlds.py` makes the worlds, `rates.py` and `samples.py` check them.
"""
