"""Stored results checked by computing a share of them again.

Read `campaign.py` first, then `sweep.py`; `compare.py` decides what counts as the same.
"""
