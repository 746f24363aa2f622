"""A channel model of halls: upright surfaces between a floor and a ceiling.

Read `geometry.py` first: a plan path and its vertical versions. `model.py` has `read_hall`, which learns heights
from some stops of a campaign; `stop.py` has `in_hall`, which takes one stop: classes, plan lengths and true
azimuths of its paths, and its estimate with versions tied; `campaign.py` does both. Below them: `record.py` (what
is kept), `paths.py` (plan path of a path as every version), `power.py` (beams lose power by elevation), `pairs.py`
(agreement of two paths), `search.py` (coarse search of heights), `classes.py` (states of paths, EM), `refine.py`
(step of heights and clocks), `groups.py` (a plan path from its versions), `tied.py` (which paths belong together).
"""
