"""Propagation paths of a scene from one TX to one receiver.

Read `propagator.py` first: it joins the exact solvers and the ray tracer. `paths.py` is the record they return.

`specular/`     reflections and transmissions, exact      `diffraction/`  edges and creeping waves
`tracer.py`     Sionna RT: diffuse paths and chains over meshes; the only user of sionna, mitsuba and drjit
`occlusion.py`  what blocks a straight leg                `deepmimo/`     paths of a DeepMIMO scenario instead
"""
