"""The model of a beam sweep, shared by all maximum-likelihood methods.

In order: `manifold.py` (`Manifold`: responses of beams over direction), `compress.py` (`CompressedSweep`),
`path_model.py` (`PathParameters` and their tangents), `false_alarms.py`, `crb.py` with `phase_information.py`
(bounds). `delay.py` serves the power method, `apparent.py` gives cone angles, `kernels.py` the compiled loops.
"""
