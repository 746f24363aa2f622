"""`arena validate halls`: channel estimates in random halls.

Read `check.py` first: the rows and their bars. `run.py` runs the rooms by the sweep engine, `statistics.py` has
the statistics of rooms, `tables.py` the tables beside the rows. The rooms are drawn by
`isac_arena.validation.scenarios.random_halls`.
"""
