"""Paths of a DeepMIMO v4 scenario, which can replace traced paths.

Read `scenario.py` first (`PathScenario`, `path_matrices`), then `folder.py` (`read_deepmimo` reads the files).
"""
