"""Synthetic stops for channel estimation: random paths through the campaign's own simulator, with their bounds.

32 x 32 beams uniform in the sine of azimuth over +-60 deg of 4 x 16 arrays, 3,168 subcarriers at 120 kHz. The SNR
of a path is that of its best beam pair after summing the subcarriers, |xi|^2 max|T|^2 max|R|^2 K / sigma^2. Cells
are Rayleigh cells: 1 / bandwidth in delay, 2 / columns in the sine of an angle.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.channel.model.crb import joint_loss_db, path_covariance, path_information
from estimation.channel.model.manifold import Manifold
from isac_arena.validation.scenarios.paths import made_paths
from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray, concatenate
from scenes.scene import Scene
from scenes.walks.trajectory import Walk
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.observation import BeamSweep
from sim.propagation.paths import Paths
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.link import Link, make_link
from sim.simulate import observe
from sim.truth import Truth

COLUMNS = 16
SECTOR_DEG = 120.0
EDGE_SINE = np.sin(np.deg2rad(55.0))  # paths stay half a beam width inside the outermost beams
FIRST_DELAY_S = (30e-9, 60e-9)
SPREAD_S = 250e-9  # of the other paths behind the first
SEPARATED_CELLS = 2.5  # from all others: paths that were not drawn as a pair
PAIR_CELLS = (0.7, 1.5)
LONE_STOP = Pose(np.array([5.0, 0.0, 1.8]), 0.0)
LONE_SCENE = Scene(
    "lone", (), Pose(np.array([0.0, 0.0, 1.8]), 0.0), Walk(np.array([[5.0, 0.0], [6.0, 0.0]]), 1.8, 0.0, 2),
    (-10.0, -10.0, 20.0, 10.0),
)  # fmt: skip


@dataclass(frozen=True)
class LinkBench:
    """A link with the manifolds of its beams: what all stops of a Monte Carlo run share."""

    config: SimulationConfig
    link: Link
    tx: Manifold
    rx: Manifold

    @property
    def n_subcarriers(self) -> int:
        """Sounded subcarriers."""
        return len(self.link.frequency_offset_hz)

    @property
    def cell(self) -> FloatArray:
        """Rayleigh cell (delay in s, sine of AoD, sine of AoA)."""
        spacing_hz = float(np.diff(self.link.frequency_offset_hz[:2])[0])
        sine = 2.0 / COLUMNS
        return np.array([1 / (self.n_subcarriers * spacing_hz), sine, sine])


@dataclass(frozen=True)
class DrawnPaths:
    """True paths of a stop, sorted by delay: delay, sines of both angles in the device frames, SNR and phase."""

    delay_s: FloatArray  # (path,)
    aod_sine: FloatArray
    aoa_sine: FloatArray
    snr_db: FloatArray
    phase_rad: FloatArray

    def __len__(self) -> int:
        return len(self.delay_s)

    @property
    def cells(self) -> FloatArray:
        """Place (path, 3) in delay and both sines, not yet in units of the cell."""
        return np.stack([self.delay_s, self.aod_sine, self.aoa_sine], axis=-1)

    @property
    def parameters(self) -> FloatArray:
        """Delay in s, AoD and AoA in rad (path, 3)."""
        return np.stack([self.delay_s, np.arcsin(self.aod_sine), np.arcsin(self.aoa_sine)], axis=-1)


@dataclass(frozen=True)
class ChannelStop:
    """One made stop: what the estimator gets, and the truth for scoring."""

    sweep: BeamSweep
    paths: DrawnPaths
    amplitude: ComplexArray  # (path,) xi in sqrt(mW)


@dataclass(frozen=True)
class TrueBounds:
    """The bounds of a stop, from the joint Fisher information of all its true paths."""

    covariance: FloatArray  # (path, 3, 3) of delay in s, AoD and AoA in rad
    loss_db: FloatArray  # (path,) SNR that the worst known parameter loses to the other paths
    separation: FloatArray  # (path,) distance in cells to the nearest other path


def make_bench(seed: int, **impairments: Any) -> LinkBench:
    """The 32 x 32 beam link with 3,168 subcarriers, and the given impairments of the hardware."""
    array = ArrayConfig(beams_per_panel=32, sector_deg=SECTOR_DEG, columns=COLUMNS)
    waveform = WaveformConfig(numerology=3, n_rb=264, combine_symbols=True)
    config = SimulationConfig(scene="lone", seed=seed, waveform=waveform, tx_array=array, rx_array=array)
    return with_settings(bench_of(config), **impairments)


def draw_paths(
    rng: np.random.Generator, cell: FloatArray, *, strongest_db: tuple[float, float], pair_share: float = 0.25
) -> DrawnPaths:
    """5 to 12 paths: the first the strongest, the others 3 to 20 dB weaker, a quarter of all in close pairs.

    All others stay `SEPARATED_CELLS` apart; the mate of a pair stands `PAIR_CELLS` from one of them in a random
    direction over delay and both sines.
    """
    count = int(rng.integers(5, 13))
    n_pairs = round(pair_share * count / 2)
    low = np.array([0.0, -EDGE_SINE, -EDGE_SINE])
    high = np.array([SPREAD_S, EDGE_SINE, EDGE_SINE])
    places = [np.array([0.0, *rng.uniform(low[1:], high[1:])])]
    while len(places) < count - n_pairs:
        _add_if_apart(places, rng.uniform(low, high), cell)
    mates = rng.choice(np.arange(1, len(places)), n_pairs, replace=False)
    for mate in mates:
        others = [place for index, place in enumerate(places) if index != mate]
        size = len(others)
        while len(others) == size:
            way = rng.standard_normal(3)
            offset = rng.uniform(*PAIR_CELLS) * way / np.linalg.norm(way) * cell
            place = places[mate] + offset
            if (np.abs(place[1:]) <= EDGE_SINE).all() and place[0] > 0:
                _add_if_apart(others, place, cell)
        places.append(others[-1])
    table = np.array(places)
    snr = np.concatenate([[0.0], -rng.uniform(3.0, 20.0, count - 1)]) + rng.uniform(*strongest_db)
    order = np.argsort(table[:, 0], kind="stable")
    delay_s, aod_sine, aoa_sine = table[order].T
    first_s = rng.uniform(*FIRST_DELAY_S)
    return DrawnPaths(first_s + delay_s, aod_sine, aoa_sine, snr[order], rng.uniform(-np.pi, np.pi, count))


def single_path(rng: np.random.Generator, snr_db: float) -> DrawnPaths:
    """One path of the given SNR anywhere."""
    delay_s = rng.uniform(FIRST_DELAY_S[0], FIRST_DELAY_S[1] + SPREAD_S, 1)
    aod_sine, aoa_sine = rng.uniform(-EDGE_SINE, EDGE_SINE, (2, 1))
    return DrawnPaths(delay_s, aod_sine, aoa_sine, np.array([snr_db]), rng.uniform(-np.pi, np.pi, 1))


def equal_pair(
    rng: np.random.Generator, cell: FloatArray, *, axis: int, cells: float, snr_db: float
) -> DrawnPaths:
    """Two equal paths of independent phases, apart on one axis (0 delay, 1 AoD, 2 AoA) by a share of its cell."""
    first = single_path(rng, snr_db)
    place = np.repeat(first.cells, 2, axis=0)
    place[:, axis] += np.array([-0.5, 0.5]) * cells * cell[axis]
    delay_s, aod_sine, aoa_sine = place.T
    return DrawnPaths(delay_s, aod_sine, aoa_sine, np.full(2, snr_db), rng.uniform(-np.pi, np.pi, 2))


def observe_paths(bench: LinkBench, paths: DrawnPaths, stop: int, background: Paths | None = None) -> ChannelStop:
    """The sweep of drawn paths at a stop through the campaign's simulator, noise and impairments included.

    The stop's number picks the random draws of noise and hardware. `background` adds paths that are no truth.
    """
    parameters = paths.parameters
    amplitude = amplitudes(bench, paths)
    drawn = level_paths(amplitude / np.sqrt(bench.link.tx_power_mw), parameters)
    every = drawn if background is None else concatenate([drawn, background], "path")
    sweep = observe(bench.config, bench.link, LONE_SCENE, Truth(every, LONE_STOP, stop, 0.0))
    return ChannelStop(sweep, paths, amplitude)


def noise_stop(bench: LinkBench, stop: int) -> BeamSweep:
    """A sweep without any path."""
    none = level_paths(np.zeros(0, complex), np.zeros((0, 3)))
    return observe(bench.config, bench.link, LONE_SCENE, Truth(none, LONE_STOP, stop, 0.0))


def true_bounds(bench: LinkBench, stop: ChannelStop, *, coherent: bool) -> TrueBounds:
    """Bounds from the joint Fisher information of all true paths of a stop."""
    link, parameters = bench.link, stop.paths.parameters
    information = path_information(
        bench.tx, bench.rx, link.frequency_offset_hz, link.noise_power_mw, parameters[:, 0],
        parameters[:, 1:2], parameters[:, 2:3], stop.amplitude, coherent=coherent,
    )  # fmt: skip
    joint = np.einsum("iaib->iab", path_covariance(information))
    return TrueBounds(joint[:, :3, :3], joint_loss_db(information), nearest(stop.paths.cells / bench.cell))


def nearest(places: FloatArray) -> FloatArray:
    """Distance (path,) from every place (path, axis) to the nearest other one, infinite for a lone one."""
    distance = np.linalg.norm(places[:, None] - places, axis=-1)
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance.min(axis=1, initial=np.inf))


def diffuse_background(
    rng: np.random.Generator, bench: LinkBench, paths: DrawnPaths, *, below_db: float, n: int = 2000
) -> Paths:
    """Dense multipath: many weak paths from everywhere behind the first path, `below_db` under it in total power.

    Delays decay exponentially with 50 ns from the first path on, angles are uniform in their sines, gains are
    circular Gaussian. Powers are those between isotropic elements.
    """
    delay = paths.delay_s[0] + rng.exponential(50e-9, n)
    sines = rng.uniform(-EDGE_SINE, EDGE_SINE, (n, 2))
    gain = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    strongest = np.abs(amplitudes(bench, paths)).max() / np.sqrt(bench.link.tx_power_mw)
    gain *= strongest * 10 ** (-below_db / 20) / np.sqrt(2 * n)
    return level_paths(gain, np.column_stack([delay, np.arcsin(sines)]))


def with_settings(bench: LinkBench, **impairments: Any) -> LinkBench:
    """The same link with other impairments."""
    settings = bench.config.model_copy(update={"impairments": ImpairmentsConfig(**impairments)})
    return replace(bench, config=settings)


def with_bandwidth(bench: LinkBench, n_rb: int) -> LinkBench:
    """The same beams over 12 subcarriers in each of `n_rb` resource blocks."""
    waveform = bench.config.waveform.model_copy(update={"n_rb": n_rb})
    return bench_of(bench.config.model_copy(update={"waveform": waveform}))


def bench_of(config: SimulationConfig) -> LinkBench:
    """The link of a simulation with its manifolds."""
    link = make_link(config)
    return LinkBench(config, link, Manifold(link.tx_codebook), Manifold(link.rx_codebook))


def amplitudes(bench: LinkBench, paths: DrawnPaths) -> ComplexArray:
    """Gains xi (path,) in sqrt(mW) that give the drawn SNRs."""
    parameters = paths.parameters
    tx = np.square(np.abs(bench.tx.response(parameters[:, 1:2]))).max(axis=1)
    rx = np.square(np.abs(bench.rx.response(parameters[:, 2:3]))) / bench.link.noise_power_mw
    magnitude = np.sqrt(10 ** (paths.snr_db / 10) / (tx * rx.max(axis=1) * bench.n_subcarriers))
    return np.asarray(magnitude * np.exp(1j * paths.phase_rad))


def level_paths(gain: ComplexArray, parameters: FloatArray) -> Paths:
    """Paths at zero elevation from gains and (path, 3) delay, AoD and AoA."""
    level = np.zeros(len(gain))
    return made_paths(gain, parameters[:, 0], (parameters[:, 1], level), (parameters[:, 2], level))


def _add_if_apart(places: list[FloatArray], place: FloatArray, cell: FloatArray) -> None:
    if min(float(np.linalg.norm((place - other) / cell)) for other in places) >= SEPARATED_CELLS:
        places.append(place)
