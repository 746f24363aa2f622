"""I/Q recordings made into beam sweeps: `importing.py` is the whole of it.

`config.py` states a recording, `samples.py` reads it, `times.py` says when which pilots are sent, `synchronise.py`
finds timing and frequency, `cut.py` demodulates the sweep, `refine.py` removes what is left of both.
"""
