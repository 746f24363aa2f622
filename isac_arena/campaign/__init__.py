"""One campaign: its settings, the chain of stages, and the directory that holds its results.

Read `driver.py` first (the stages in order), then `chain` (their functions), `stages.py` (a run on a directory),
`stored.py` (what it holds of every stop) and `directory.py` (which file holds what). `load.py` finds campaign
files; `library/` holds those of the project.
"""
