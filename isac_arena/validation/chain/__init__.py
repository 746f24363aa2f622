"""`arena validate chain`: the whole chain in random halls and in every library campaign.

Read `check.py` first: the rows and their bars. `campaigns.py` says which campaigns run, with which settings.
`run.py` runs them by the sweep engine. `statistics.py` has the statistics of stops and objects, `tables.py` the
tables beside the rows, `trials.py` the trials of SLAM with paths made from the truth.
"""
