"""A channel model of halls: upright surfaces between a floor and a ceiling.

Read `geometry.py` first: a plan path and its vertical versions. `model.py` has `read_hall`, which learns the
heights of a campaign, and `classify.py` has `classify`, which gives classes, plan lengths and true azimuths.
Below them: `paths.py` (plan path of a path as every version), `power.py` (beams lose power by elevation),
`pairs.py` (agreement of two paths), `search.py` (coarse search), `classes.py` (states of paths, EM) and
`refine.py` (step of heights and clocks).

Campaigns do not call it yet: it is for use from Python. Give the height of the TX. With horizontal beams, in halls
where few versions are seen, the heights can be wrong; `HallModel.others` does not always hold the true ones then.
"""
