"""All propagation paths of a scene: traced ones and exact reflections off curved contours, in one order."""

from __future__ import annotations

import numpy as np

from scenes.record import FloatArray, concatenate
from scenes.scene import Scene
from sim.config import PropagationConfig
from sim.curved import curved_reflections
from sim.occlusion import occluders
from sim.paths import Paths, canonical_order, with_bounce_slots
from sim.raytrace import Tracer, n_bounce_slots


class Propagator:
    """A scene made ready for tracing, to be asked for one receiver position after the other.

    Making one takes seconds (the tracer is imported and the scene loaded). Raises `sim.llvm.LlvmError` where
    there is no usable LLVM library.
    """

    def __init__(self, scene: Scene, carrier_hz: float, config: PropagationConfig | None = None) -> None:
        self._scene = scene
        self._carrier_hz = carrier_hz
        self._config = config or PropagationConfig()
        self._tracer = Tracer(scene, carrier_hz, self._config)
        self._faces = occluders(scene)

    def paths(self, rx_position_m: FloatArray) -> Paths:
        """All paths from the scene's TX to a receiver (xyz,), in canonical order, `max_bounces` slots each.

        Line of sight, specular reflections off planes up to `max_bounces`, first-order specular reflections off
        curved contours, and first-order diffuse scattering. The same bits on every run, whatever was asked before.
        """
        parts = [self._tracer.trace(rx_position_m)]
        if self._config.max_bounces:
            [curved] = curved_reflections(
                self._scene, np.asarray(rx_position_m)[None], self._carrier_hz, self._faces
            )
            parts.append(with_bounce_slots(curved, n_bounce_slots(self._config)))
        return canonical_order(concatenate(parts, "path"))


def propagate(
    scene: Scene, rx_positions_m: FloatArray, *, carrier_hz: float, config: PropagationConfig | None = None
) -> list[Paths]:
    """Paths to each receiver position (receiver, xyz), one record each; see `Propagator.paths`."""
    propagator = Propagator(scene, carrier_hz, config)
    return [propagator.paths(position) for position in np.atleast_2d(rx_positions_m)]
