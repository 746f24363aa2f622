"""Hardware that is not ideal: arrays, oscillators, clocks and the front end of the receiver.

Read `config.py` first (every impairment with its unit), then `impairments.py`; `application.py` says which is
applied where.
"""
