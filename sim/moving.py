"""The truth of a stop in a world that moves: paths with their rates, and how they change during the sweep."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from scenes.motion.motion import BodyMotion
from scenes.pose import SPEED_OF_LIGHT_M_S, azimuth_elevation
from scenes.record import FloatArray, IntArray, concatenate
from scenes.scene import Scene
from scenes.walks.trajectory import velocities_m_s
from sim.clock import CampaignClock, checked_clock
from sim.config import SimulationConfig
from sim.propagation.motion.rates import path_rates
from sim.propagation.motion.sweep import SweepTrace
from sim.propagation.motion.tracks import SweepMotion
from sim.propagation.occlusion import surface_names
from sim.propagation.paths import Paths
from sim.propagation.propagator import PlanarComparison, Propagator
from sim.propagation.specular.facets import TracedChains
from sim.signal.hardware.apply_impairments import RandomStage, stage_generator


def moving_paths(
    config: SimulationConfig, scene: Scene, stops: Iterable[int]
) -> Iterator[tuple[int, Paths, SweepMotion, PlanarComparison]]:
    """Stop, its paths at the middle symbol of its sweep, their motion, and the counts of planar paths.

    Raises `ValueError` where something drives through something else.
    """
    clock = checked_clock(config, scene)
    world = MovingWorld(config, scene, clock)
    for stop in stops:
        yield stop, *world.swept(stop)


class MovingWorld:
    """A moving scene with its clock; the solver is kept as long as nothing but the receiver moves."""

    def __init__(self, config: SimulationConfig, scene: Scene, clock: CampaignClock) -> None:
        self._config, self._scene, self._clock = config, scene, clock
        self._carrier_hz = config.waveform.carrier_ghz * 1e9
        self._velocity, self._position = velocities_m_s(scene.walk), scene.walk.positions_m()
        self._kept: dict[tuple[float, bool], Propagator] = {}
        self._stop = 0
        self._first_mesh = len(surface_names(scene)) - len(scene.clutter)

    def swept(self, stop: int) -> tuple[Paths, SweepMotion, PlanarComparison]:
        """The paths of a stop and how they change during its sweep."""
        self._stop = stop  # whose random numbers targets have
        time_s, velocity = float(self._clock.middle_s[stop]), self._velocity[stop]
        rx_m = self._position[stop]
        whole = self._propagator(time_s, traces=True)
        paths, compared = whole.compared_paths(rx_m)
        chains = whole.mesh_chains(rx_m)
        middle = whole.with_rates(paths, self._scene.bodies_at(time_s, rx_m, velocity))
        exact = middle.take("path", ~middle.is_diffuse)

        def trace(later_s: float, objects: IntArray | None) -> tuple[Paths, IntArray]:
            """Exact paths with their rates, this many s after `time_s`; only of some `objects` where given."""
            if later_s == 0.0 and objects is None:
                return exact, whole.bounce_pieces(exact)
            now_s, here = time_s + later_s, rx_m + later_s * velocity
            solver = self._propagator(now_s, traces=False)
            moved = None if chains is None else self._carried(chains, time_s, now_s)
            solver = solver if objects is None else solver.restricted(objects)
            found = solver.exact_paths(here, moved)
            bodies = self._scene.bodies_at(now_s, here, velocity)
            return solver.with_rates(found, bodies), solver.bounce_pieces(found)

        order_s = self._clock.order_s
        speed = self._top_speed(float(np.linalg.norm(velocity)))
        traced = SweepTrace(
            trace, order_s, self._carrier_hz, np.deg2rad(self._config.propagation.retrace_phase_deg), speed
        )
        traced.run()
        diffuse = middle.take("path", middle.is_diffuse)
        if self._scene.movers:
            self._kept.clear()
        return middle, self._motion(traced, diffuse, time_s, rx_m, velocity), compared

    def _motion(
        self, traced: SweepTrace, diffuse: Paths, time_s: float, rx_m: FloatArray, velocity: FloatArray
    ) -> SweepMotion:
        """The stretches of the exact paths, and one over the whole sweep for every diffuse path."""
        ends_s = float(traced.time_s[0]), 0.0, float(traced.time_s[-1])
        states, state_s = list(traced.states), list(traced.state_s)
        n, count = traced.n_states, len(diffuse)
        for later_s in ends_s:
            here = rx_m + later_s * velocity
            bodies = self._scene.bodies_at(time_s + later_s, here, velocity)
            states.append(self._scattered(diffuse, time_s, time_s + later_s, bodies))
            state_s.append(np.full(count, later_s))
        rows = np.array(traced.stretch, float).reshape(-1, 5)
        index = n + np.arange(3)[:, None] * count + np.arange(count)
        first, middle, last = (np.concatenate([rows[:, place].astype(int), index[place]]) for place in range(3))
        return SweepMotion(
            states=concatenate(states, "path"),
            state_s=np.concatenate(state_s),
            first=first,
            middle=middle,
            last=last,
            from_s=np.concatenate([rows[:, 3], np.full(count, ends_s[0])]),
            to_s=np.concatenate([rows[:, 4], np.full(count, np.inf)]),
            time_s=time_s,
            rx_velocity_m_s=velocity,
            n_traces=traced.n_traces,
            second_order_phase_rad=traced.second_order_phase_rad,
        )

    def _scattered(self, paths: Paths, from_s: float, to_s: float, bodies: BodyMotion) -> Paths:
        """Diffuse paths at another time: their points stay on their bodies, and keep what they scatter."""
        first = paths.vertex_m[:, 0]
        point = self._scene.carried_points(paths.bounce_object[:, 0], first, from_s, to_s)
        legs = point - bodies.pivot_m[-2], point - bodies.pivot_m[-1]
        lengths = [np.linalg.norm(leg, axis=1) for leg in legs]
        tx, rx = (
            self._scene.at(from_s).tx.position_m,
            bodies.pivot_m[-1] - (to_s - from_s) * bodies.velocity_m_s[-1],
        )
        before = [np.linalg.norm(first - end, axis=1) for end in (tx, rx)]
        length = lengths[0] + lengths[1]
        turn = np.exp(-2j * np.pi * self._carrier_hz * (length / SPEED_OF_LIGHT_M_S - paths.delay_s))
        departure, arrival = (azimuth_elevation(leg) for leg in legs)
        vertex = paths.vertex_m.copy()
        vertex[:, 0] = point
        moved = replace(
            paths,
            gain=paths.gain * turn * (before[0] * before[1] / (lengths[0] * lengths[1])),
            delay_s=length / SPEED_OF_LIGHT_M_S,
            aod_azimuth_rad=departure[0],
            aod_elevation_rad=departure[1],
            aoa_azimuth_rad=arrival[0],
            aoa_elevation_rad=arrival[1],
            vertex_m=vertex,
        )
        return replace(moved, rates=path_rates(moved, bodies, self._scene, None, {}, None, self._carrier_hz))

    def _propagator(self, time_s: float, *, traces: bool) -> Propagator:
        """The solver of the scene at a time, the same one where only the receiver moves."""
        key = (time_s if self._scene.movers else 0.0, traces)
        if key not in self._kept:
            frozen = self._scene.at(time_s)
            self._kept[key] = Propagator(frozen, self._carrier_hz, self._config.propagation, traces=traces)
        return self._kept[key].drawn(stage_generator(self._config.seed, RandomStage.TARGETS, self._stop))

    def _carried(self, chains: TracedChains, from_s: float, to_s: float) -> TracedChains:
        """Chains of triangles at another time."""
        shape = chains.corner_m.shape
        surface = np.broadcast_to(chains.surface[..., None], shape[:-1])
        moved = self._scene.carried_points(surface.ravel(), chains.corner_m.reshape(-1, 3), from_s, to_s)
        return replace(chains, corner_m=moved.reshape(shape))

    def _top_speed(self, rx_m_s: float) -> float:
        """Highest speed of anything against anything in m/s."""
        speeds = [motion.top_speed_m_s + motion.top_turn_rate_rad_s for motion in self._scene.movers.values()]
        return rx_m_s + max(speeds, default=0.0)
