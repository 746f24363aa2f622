"""Checks of waveform, arrays and samples.

Read `waveform.py` first, then `generation.py`.
"""
