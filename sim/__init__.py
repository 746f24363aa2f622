"""The wave and the receiver: from a scene to received samples.

Read `simulate.py` first: `simulate_truth` traces the paths of each stop, `observe` computes its samples.

`propagation/`    paths of a scene: exact solvers and the ray tracer
`signal/`         arrays, waveform, hardware and equation (1)
`observation.py`  `BeamSweep`, what the receiver measures    `truth.py`  `Truth`, for scoring only
`config.py`       `SimulationConfig`, the settings of a simulated campaign
"""
