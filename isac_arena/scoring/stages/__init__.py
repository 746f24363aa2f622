"""The scores of each stage.

In the order of the chain: `channel.py`, `poses.py`, `maps.py`, `shapes.py` (the paper's), `contours.py` (ours),
`scene.py`.
"""
