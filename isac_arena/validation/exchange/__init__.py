"""`arena validate exchange`: functions of users in place of stages, and paths from elsewhere.

`functions.py` has good and bad functions of every stage, `stages.py` runs them, `paths.py` imports tables.
"""
