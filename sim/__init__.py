"""The wave and the receiver: a scene in, samples out.

Read `simulate.py` first: `simulate_truth` traces the paths of a stop, `observe` makes its samples.

`propagation/`    paths of a scene: exact solvers and the ray tracer
`signal/`         arrays, waveform, hardware and equation (1)
`observation.py`  `BeamSweep`, all that a receiver has       `truth.py`  `Truth`, for scoring only
`config.py`       settings of a simulated campaign
"""
