"""Paths that a DeepMIMO v4 scenario holds, in place of traced ones.

Read `scenario.py` first (matrices to paths), then `folder.py` (the files).
"""
