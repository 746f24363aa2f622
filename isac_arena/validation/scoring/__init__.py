"""Checks of the scores themselves, on a campaign with known faults (`../scenarios/perfect_campaign.py`).

Read `metrics.py` first.
"""
