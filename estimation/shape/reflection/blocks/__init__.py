"""Blocks: bodies with four flat faces, from the points that their faces and corners scattered.

Read `find.py` first; `fit.py` has the models and their evidence, `law.py` the density of the points of a block.
"""
