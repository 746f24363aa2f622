"""One campaign: its settings, the chain of stages, and the directory that holds its results.

Read `chain.py` first (records in, records out), then `stages.py` (the same over files) and `directory.py` (which
file holds what). `load.py` finds campaign files; `library/` holds those of the project.
"""
