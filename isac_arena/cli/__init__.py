"""The `arena` command: one module per group of verbs.

Read `main.py` first, then `campaign.py`.
"""
