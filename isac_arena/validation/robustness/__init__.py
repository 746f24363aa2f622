"""`arena validate robustness`: the attack on every border as a program with a seed.

Read `check.py` first: the rows and their bars. `attempt.py` runs a command in a process of its own and says how it
ended. `schemas.py` makes hostile values from the schemas of the settings, `files.py` damages files, `functions.py`
has bad estimators, `inputs.py` tries settings and input files, `made.py` has the run that is attacked, `damage.py`
damages all its files, `runs.py` attacks it while it works, and `sweeps.py` attacks sweeps.
"""
