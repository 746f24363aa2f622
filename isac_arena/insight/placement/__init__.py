"""Where to put TX: the places, of many candidates, from which poses and contours have the smallest bounds.

Read `search.py` first: greedy and exhaustive search with a certificate. `criterion.py` has what is minimised,
`candidates.py` the places, `placement.py` all together, `achieved.py` a run with the chosen TX.
"""
