"""The scores of each stage.

In the order of the chain: `channel.py` (`score_stop`), `poses.py`, `maps.py`, `shapes.py` (the paper's),
`contours.py` (ours), `scene.py`. `outlines.py` has the columns that both kinds of contours share.
"""
