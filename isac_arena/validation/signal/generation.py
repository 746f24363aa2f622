"""Generated sweeps against a slow direct evaluation, and every impairment estimated from the samples."""

from dataclasses import replace

import numpy as np
from scipy.linalg import dft
from scipy.optimize import minimize_scalar
from scipy.special import erfinv

from isac_arena.validation.benches.signal import ORIGIN, noiseless_cube, signal_link
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.paths import made_paths, random_paths
from scenes.config import load_scene, scene_path
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import ComplexArray, FloatArray
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.propagation.paths import Paths
from sim.signal.arrays.codebook import beam_response
from sim.signal.hardware.apply_impairments import impaired_codebooks, with_surveyed_pose
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.hardware.impairments import coupling_matrix, fft_bins
from sim.signal.link import Link, make_link
from sim.signal.waveform.occasions import sweep_occasions
from sim.simulate import clock_biases_s, observe
from sim.truth import Truth

PATH_COUNTS = (1, 64, 3_000)
AOD_RAD = (0.21, 0.13)  # not in a null of a beam


def check_equation_1(seed: int, quick: bool) -> list[Measurement]:
    """Beam channels of few and of many paths against equation (1) summed path by path in double precision."""
    rng = np.random.default_rng(seed)
    link = signal_link()
    rows = []
    for count in PATH_COUNTS if quick else (*PATH_COUNTS, 20_000):
        paths = random_paths(rng, count)
        chosen = np.sort(rng.choice(len(link.frequency_offset_hz), 24, replace=False))
        chosen[[0, -1]] = 0, len(link.frequency_offset_hz) - 1
        expected = direct_channel(link, paths, link.frequency_offset_hz[chosen])
        fast = noiseless_cube(link, paths)[:, :, chosen]
        error = float(np.abs(fast - expected).max() / np.abs(expected).max())
        reason = "largest error over largest sample, both band edges among the subcarriers"
        rows.append(at_most(f"signal.equation_1.{count}_paths", error, 1e-6, reason))
    return rows


def check_oscillators(seed: int, quick: bool) -> list[Measurement]:
    """Clock bias and drift, CFO and phase noise from phases of a line of sight over subcarriers and symbols."""
    bench, narrow = ImpairmentBench(seed), ImpairmentBench(seed, n_rb=24)
    time_s = sweep_occasions(bench.config().waveform, 32, 32).time_s[0]
    stops = range(12 if quick else 60)  # 1,024 symbols each: 1.3 or 0.6 % for a variance

    biased = bench.config(clock_bias_std_ns=5.0)
    bias_s = clock_biases_s(biased, 4)[3]
    found_bias_s = np.median(bench.delays_s(bench.ratio(biased, 0, bias_s=bias_s)))
    drift = bench.delays_s(bench.ratio(bench.config(clock_drift_ppm=20.0), 0))
    found_ppm = np.polyfit(time_s.ravel(), drift.ravel(), 1)[0] * 1e6
    cfo = bench.phases_rad(bench.ratio(bench.config(cfo_hz=1500.0), 0)).ravel()
    found_hz = np.polyfit(time_s.ravel(), np.unwrap(cfo), 1)[0] / (2 * np.pi)
    walking = narrow.config(phase_noise_pair_deg=6.0)
    steps = [np.diff(np.unwrap(narrow.phases_rad(narrow.ratio(walking, s)).ravel())) for s in stops]
    noisy = narrow.config(phase_noise_linewidth_hz=300.0)
    common = [narrow.phases_rad(narrow.ratio(noisy, s)).ravel() for s in stops]
    found_linewidth = np.square(common).mean() * 3 * 120e3 / (2 * np.pi)
    return [
        _recovered("clock_bias", found_bias_s, bias_s, "slope of the phase over subcarriers"),
        _recovered("clock_drift", found_ppm, 20.0, "slope of that delay over the sweep"),
        _recovered("cfo", found_hz, 1500.0, "slope of the common phase over the sweep"),
        _recovered("phase_noise_pair", np.rad2deg(np.std(steps)), 6.0, "steps from symbol to symbol"),
        _recovered("phase_noise_linewidth", found_linewidth, 300.0, "common phase variance 2 pi L T / 3"),
    ]


def check_front_end(seed: int, quick: bool) -> list[Measurement]:
    """IQ imbalance, quantiser step and clipping level from the strongest beam pair."""
    bench = ImpairmentBench(seed)
    clean = bench.samples(bench.config(), 0)
    best = np.unravel_index(np.argmax(np.linalg.norm(clean, axis=2)), clean.shape[:2])
    strong = clean[best]
    bins, n_fft = fft_bins(bench.link.frequency_offset_hz, 120e3)
    grid = np.zeros(n_fft, complex)
    grid[bins] = strong
    mirrored = grid[-bins % n_fft].conj()
    imbalance = bench.samples(bench.config(iq_gain_db=0.8, iq_phase_deg=4.0), 0)[best]
    direct, _ = np.linalg.lstsq(np.stack([strong, mirrored], axis=1), imbalance, rcond=None)[0]
    gain = 2 * direct - 1
    rms = np.linalg.norm(strong) / np.sqrt(2 * n_fft)
    error = bench.samples(bench.config(adc_bits=8), 0)[best] - strong
    step = np.sqrt(6 * np.mean(np.abs(error) ** 2))
    true_step = rms * 10 ** (15 / 20) / 2**7
    limited = bench.samples(bench.config(adc_clip_db=0.0), 0)[best]
    slope = float((limited @ strong.conj()).real / np.linalg.norm(strong) ** 2)
    return [
        _recovered("iq_gain", 20 * np.log10(np.abs(gain)), 0.8, "least squares on mirrored subcarriers"),
        _recovered("iq_phase", -np.rad2deg(np.angle(gain)), 4.0, "least squares on mirrored subcarriers"),
        _recovered("adc_step", step, true_step, "error variance step^2 / 12 of each converter"),
        _recovered("adc_clip", np.sqrt(2) * erfinv(slope), 1.0, "Bussgang gain erf(level / sqrt 2 rms)"),
    ]


def check_arrays_as_built(seed: int, quick: bool) -> list[Measurement]:
    """Element errors, coupling, beam phases and pointing from the TX beams of a line of sight; the survey."""
    bench = ImpairmentBench(seed, orthogonal=True)
    weights, position_m = bench.link.tx_codebook.weights, bench.link.tx_codebook.element_position_m
    errors = bench.config(element_gain_std_db=1.0, element_phase_std_deg=10.0)
    built = np.linalg.lstsq(weights, impaired_codebooks(errors, bench.link)[0].weights, rcond=None)[0]
    element = bench.element_field(errors) / bench.element_field(bench.config())
    drawn = np.diag(built)
    element *= (drawn @ element.conj()) / np.linalg.norm(element) ** 2  # the scale is the RX array's
    coupled = bench.element_field(bench.config(coupling_db=-18.0))
    plain = bench.element_field(bench.config())
    neighbours = (coupling_matrix(position_m, 60e9, 0.0) - np.eye(len(position_m))) @ plain
    scale, share = np.linalg.lstsq(np.stack([plain, neighbours], axis=1), coupled, rcond=None)[0]
    turned = bench.config(beam_phase_std_deg=40.0)
    phase = bench.phases_rad(bench.ratio(turned, 0))
    true_tx, _ = impaired_codebooks(turned, bench.link)
    drawn_rad = np.angle((true_tx.weights * weights.conj()).sum(axis=1))
    found_rad = np.angle(np.exp(1j * (phase - phase[:1])))[:, 0]
    phase_gap = np.angle(np.exp(1j * (found_rad - drawn_rad + drawn_rad[0])))
    pointing_deg = bench.pointing_deg(bench.config(tx_pointing_offset_deg=2.0))
    return [
        _relative("element_errors", element - drawn, drawn - drawn.mean(), "inverted DFT beams"),
        _recovered("coupling", abs(share / scale), 10 ** (-18 / 20), "least squares on the element field"),
        _relative("beam_phase", phase_gap, drawn_rad, "phase over TX beams"),
        _recovered("tx_pointing", pointing_deg, 2.0, "beam powers"),
        *_survey(bench, 4_000 if quick else 20_000),
    ]


class ImpairmentBench:
    """One strong path of 2 m between two arrays in fixed noise, to show what one impairment changes.

    With `orthogonal` the TX has 64 orthonormal beams, which separate its 64 elements.
    """

    def __init__(self, seed: int, *, orthogonal: bool = False, n_rb: int = 264) -> None:
        array = ArrayConfig(beams_per_panel=64 if orthogonal else 32)
        waveform = WaveformConfig(combine_symbols=True, n_rb=n_rb)
        self._base = SimulationConfig(
            scene="box_room", seed=seed, waveform=waveform, tx_array=array, rx_array=ArrayConfig()
        )
        self.link = make_link(self._base)
        if orthogonal:
            square = replace(self.link.tx_codebook, weights=dft(64, scale="sqrtn"))
            self.link = replace(self.link, tx_codebook=square)
        self.scene = load_scene(scene_path("box_room"), 60e9)
        heading_rad = self.scene.tx.heading_rad
        self._rx_pose = Pose(self.scene.tx.position_m, float(heading_rad + np.pi))
        departure_rad = heading_rad + AOD_RAD[0], AOD_RAD[1]
        arrival_rad = heading_rad + np.pi + AOD_RAD[0], -AOD_RAD[1]
        self._paths = made_paths(1.0 + 0j, 2.0 / SPEED_OF_LIGHT_M_S, departure_rad, arrival_rad)

    def config(self, **impairments: float) -> SimulationConfig:
        """The settings with only these impairments."""
        return self._base.model_copy(update={"impairments": ImpairmentsConfig(**impairments)})  # type: ignore[arg-type]

    def truth(self, stop: int, bias_s: float = 0.0) -> Truth:
        """The line of sight at one stop."""
        return Truth(self._paths, self._rx_pose, stop, bias_s)

    def samples(self, config: SimulationConfig, stop: int, bias_s: float = 0.0) -> ComplexArray:
        """Received samples (tx_beam, rx_beam, subcarrier)."""
        return observe(config, self.link, self.scene, self.truth(stop, bias_s)).samples

    def ratio(self, config: SimulationConfig, stop: int, bias_s: float = 0.0) -> ComplexArray:
        """Impaired samples times the conjugate of those without impairments and clock bias."""
        impaired = self.samples(config, stop, bias_s)
        return np.asarray(impaired * self.samples(self.config(), stop).conj())

    def phases_rad(self, ratio: ComplexArray) -> FloatArray:
        """Common phase (tx_beam, rx_beam) of every pair."""
        return np.asarray(np.angle(ratio.sum(axis=2)))

    def delays_s(self, ratio: ComplexArray) -> FloatArray:
        """Delay (tx_beam, rx_beam) of every pair from the mean phase step between subcarriers."""
        step_hz = float(np.diff(self.link.frequency_offset_hz[:2])[0])
        half = ratio.shape[2] // 2
        coarse = np.angle((ratio[..., 1:] * ratio[..., :-1].conj()).sum(axis=2))
        turn = np.exp(-1j * coarse[..., None] * np.arange(ratio.shape[2]))
        low, high = (ratio * turn)[..., :half].sum(axis=2), (ratio * turn)[..., half:].sum(axis=2)
        fine = np.angle(high * low.conj()) / (ratio.shape[2] / 2)
        return np.asarray(-(coarse + fine) / (2 * np.pi * step_hz))

    def element_field(self, config: SimulationConfig) -> ComplexArray:
        """Field (element,) that the TX elements put on the line of sight, from inverted beam weights."""
        samples = self.samples(config, 0) * self.link.prs_symbol.conj()[:, None, :]
        turn = np.exp(2j * np.pi * self.link.frequency_offset_hz * self._paths.delay_s)
        received = samples @ turn / len(turn)
        best = np.argmax(np.linalg.norm(received, axis=0))
        return np.asarray(np.linalg.lstsq(self.link.tx_codebook.weights, received[:, best], rcond=None)[0])

    def pointing_deg(self, config: SimulationConfig) -> float:
        """TX heading over nominal that explains the powers of the TX beams best."""
        power = (np.abs(self.samples(config, 0)) ** 2).sum(axis=(1, 2))
        power = power / np.linalg.norm(power)

        def mismatch(offset_deg: float) -> float:
            azimuth_rad = AOD_RAD[0] - np.deg2rad(offset_deg)
            model = np.abs(beam_response(self.link.tx_codebook, azimuth_rad, AOD_RAD[1])[:, 0]) ** 2
            return -float(power @ model / np.linalg.norm(model))

        return float(minimize_scalar(mismatch, bounds=(-6, 6), method="bounded").x)


def direct_channel(link: Link, paths: Paths, frequency_hz: FloatArray) -> ComplexArray:
    """Equation (1) (tx_beam, rx_beam, subcarrier) as it is written, one path after the other."""
    tx = beam_response(link.tx_codebook, paths.aod_azimuth_rad - ORIGIN.heading_rad, paths.aod_elevation_rad)
    rx = beam_response(link.rx_codebook, paths.aoa_azimuth_rad - ORIGIN.heading_rad, paths.aoa_elevation_rad)
    channel = np.zeros((len(tx), len(rx), len(frequency_hz)), complex)
    for path in range(len(paths)):
        wave = paths.gain[path] * np.exp(-2j * np.pi * frequency_hz * paths.delay_s[path])
        channel += tx[:, path, None, None] * rx[None, :, path, None] * wave
    return channel


def _survey(bench: ImpairmentBench, n_stops: int) -> list[Measurement]:
    config = bench.config(rx_placement_std_m=0.1, rx_heading_std_deg=2.0)
    truths = [bench.truth(stop) for stop in range(n_stops)]
    poses = [with_surveyed_pose(config, truth).rx_pose for truth in truths]
    pairs = [(pose, truth.rx_pose) for pose, truth in zip(poses, truths, strict=True)]
    moved_m = np.array([(pose.position_m - true.position_m)[:2] for pose, true in pairs])
    turned = np.array([pose.heading_rad - true.heading_rad for pose, true in pairs])
    turned = np.angle(np.exp(1j * turned))
    return [
        _recovered("rx_placement", moved_m.std(), 0.1, "standard deviation over stops"),
        _recovered("rx_heading", np.rad2deg(turned.std()), 2.0, "standard deviation over stops"),
    ]


def _recovered(name: str, found: float, true: float, how: str) -> Measurement:
    return at_most(f"signal.impairment.{name}", abs(found / true - 1), 0.05, how)


def _relative(
    name: str, error: ComplexArray | FloatArray, size: ComplexArray | FloatArray, how: str
) -> Measurement:
    return at_most(f"signal.impairment.{name}", np.linalg.norm(error) / np.linalg.norm(size), 0.05, how)
