"""Checks of the scores themselves, on a campaign with known faults (`made_campaign.py`).

Read `metrics.py` first.
"""
