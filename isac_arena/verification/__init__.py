"""Stored results checked by computing a share of them once more.

Read `campaign.py` first, then `sweep.py`; `compare.py` decides what counts as the same.
"""
