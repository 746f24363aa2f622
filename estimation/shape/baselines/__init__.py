"""Peer methods for incidence points only, for comparison.

Read `peers.py` first; `recursive.py` holds the recursive ones.
"""
