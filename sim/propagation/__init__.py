"""Propagation paths of a scene from one TX to its receivers.

Read `propagator.py` first: `propagate` and `Propagator` combine the exact solvers and the ray tracer. They return
`Paths` of `paths.py`.

`specular/`     reflections and transmissions, exact      `diffraction/`  edges and creeping waves
`tracer.py`     Sionna RT: diffuse paths and reflections off meshes; the only user of sionna, mitsuba and drjit
`motion/`       paths that change during a sweep: exact Doppler and rates
`occlusion.py`  faces that block a straight leg           `deepmimo/`     paths of a DeepMIMO scenario
"""
