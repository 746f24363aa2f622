"""`arena validate robustness`: the attack on every border as a program with a seed.

Read `check.py` first: the rows and their bars. `attempt.py` runs a command in a process of its own and says how it
ended. `schemas.py` makes hostile values from the schemas of the settings, `files.py` damages files, `functions.py`
has bad estimators, `inputs.py` tries settings and input files, `runs.py` attacks runs, and `made.py` has the run.
"""
