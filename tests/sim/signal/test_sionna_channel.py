"""The generator of the sweeps against Sionna's own channel between the elements of two panels."""

import numpy as np

from isac_arena.validation.benches.signal import noiseless_cube
from isac_arena.validation.benches.sionna import in_order_of, sionna_swept
from scenes.config import load_scene, scene_path
from sim.config import ArrayConfig, PropagationConfig, SimulationConfig
from sim.propagation.tracer import Tracer, solved_between_panels
from sim.signal.link import make_link


def test_beams_of_both_ends_phases_and_delays_agree() -> None:
    scene, settings = load_scene(scene_path("box_room")), PropagationConfig(diffuse_samples=0)
    array = ArrayConfig(rows=2, columns=4, beams_per_panel=5)
    link = make_link(SimulationConfig(scene="-", tx_array=array, rx_array=array))
    rx = scene.stops[1]
    solved, element_m = solved_between_panels(scene, rx, 60e9, settings, rows=2, columns=4)
    paths = Tracer(scene, 60e9, settings).specular(rx.position_m)
    assert len(paths) > 10
    frequency_hz = link.frequency_offset_hz[::200]
    ours = noiseless_cube(link, paths, scene.tx, rx, frequency_hz)
    theirs = sionna_swept(solved, in_order_of(link, element_m), frequency_hz)
    # Single precision rounds Sionna's delays by 1 fs: 0.4 mrad at 60 GHz.
    assert np.abs(ours - theirs).max() < 1e-3 * np.abs(theirs).max()
