"""A recording of an independent transmitter and channel, synchronised and estimated: errors over their bound."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from estimation.channel.estimate import estimate_channel
from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.config import CampaignConfig
from isac_arena.exchange.iq.config import RecordingConfig
from isac_arena.exchange.iq.importing import Receiver, RecordedSweep
from isac_arena.exchange.iq.samples import IqRecording
from isac_arena.validation.exchange import independent as other
from isac_arena.validation.exchange.independent import PlaneWaves, ReceiverErrors
from isac_arena.validation.measurement import InfoTable, Measured, at_most
from isac_arena.validation.monte_carlo import generators, quick_bar
from scenes.pose import Pose
from scenes.record import FloatArray

TRIALS, QUICK_TRIALS = 20, 1
BAR = 1.1
CFO_HZ, NOISE = 1000.0, 1.5
FAR = 6.0  # bounds: an estimate further away is not of this path
N_PATHS = 3


def check_recordings(seed: int, quick: bool) -> Measured:
    """CFO 1 kHz, timing within 15 us and sampling offset within 10 ppm: delays and angles over their bounds."""
    trials = QUICK_TRIALS if quick else TRIALS
    ratios = np.array([_ratios(rng) for rng in generators(seed, trials)])  # (trial, path, parameter)
    rms = np.sqrt(np.mean(np.square(ratios), axis=(0, 1)))
    overall = float(np.sqrt(np.mean(np.square(ratios))))
    error = 1 / np.sqrt(2 * ratios.size)
    row = at_most(
        "exchange.recordings.rmse_over_bound", overall, quick_bar(BAR, error, quick),
        "RMSE of delays and angles over the joint bound with timing, CFO and drift unknown",
    )  # fmt: skip
    names = ("delay", "departure", "arrival")
    table = InfoTable(
        f"{trials} recordings of an independent transmitter", ("parameter", "RMSE over bound"),
        tuple((name, float(value)) for name, value in zip(names, rms, strict=True)),
    )  # fmt: skip
    return Measured([row], (table,))


def receiver(folder: Path) -> Receiver:
    """The receiver of the independent waveform; its beams are in files of weights in a folder."""
    arrays = {}
    for name, n in (("tx_array", other.N_TX), ("rx_array", other.N_RX)):
        np.savez(folder / f"{name}.npz", weights=other.beams(n)[0])
        arrays[name] = {
            "rows": 1, "columns": n, "element_pattern": "isotropic", "panel_azimuth_deg": [0.0],
            "codebook": "file", "weights_file": str(folder / f"{name}.npz"),
        }  # fmt: skip
    waveform = {
        "n_rb": other.N_RB, "comb": other.COMB, "numerology": other.MU, "combine_symbols": True,
        "schedule": {"period_slots": other.PERIOD_SLOTS},
    }  # fmt: skip
    settings = {"name": "independent", "scene": "independent", "waveform": waveform, **arrays}
    stated = RecordingConfig.model_validate({"stops": [{"files": ["-"]}], "sample_rate_hz": other.RATE_HZ})
    return Receiver.make(CampaignConfig.model_validate(settings), stated, folder, Pose(np.zeros(3), 0.0))


def draw(rng: np.random.Generator) -> tuple[PlaneWaves, ReceiverErrors]:
    """Paths that are resolved in direction, and the errors of a receiver."""
    aod, aoa = (rng.permutation([-0.55, 0.0, 0.55]) + rng.uniform(-0.1, 0.1, N_PATHS) for _ in range(2))
    phase = np.exp(2j * np.pi * rng.random(N_PATHS))
    paths = PlaneWaves(
        10e-9 + np.sort(rng.uniform(0, 150e-9, N_PATHS)), aod, aoa, np.array([1, 0.4, 0.25]) * phase
    )
    return paths, ReceiverErrors(rng.uniform(0, 15e-6), CFO_HZ, rng.uniform(-10e-6, 10e-6), NOISE)


def _ratios(rng: np.random.Generator) -> FloatArray:
    """ReceiverErrors (path, parameter) of delay and the sines of both angles over their bounds."""
    paths, errors = draw(rng)
    samples = other.record(paths, errors, rng).astype(np.complex64)
    recording = IqRecording(samples, np.zeros(1, int), np.zeros(1, int), other.RATE_HZ)
    with TemporaryDirectory() as name:
        heard = receiver(Path(name))
    found = heard.sweep(recording, 0)
    estimate = estimate_channel(found.sweep)
    bound = joint_bound(paths, errors.noise, heard.times.start_s[0, :, :, 0])
    return _over_bound(estimate, paths, late_s(found, errors), bound)


def late_s(found: RecordedSweep, errors: ReceiverErrors) -> float:
    """What the delays of a sweep lack: its zero, in the middle, against that of the transmitter."""
    sync, middle_s = found.synchronisation, found.middle_s
    return (sync.offset_s + (1 + sync.drift) * middle_s) / (1 + errors.drift) - middle_s - errors.timing_s


def _over_bound(estimate: ChannelEstimate, paths: PlaneWaves, late: float, bound: FloatArray) -> FloatArray:
    sines = (np.sin(angle) for angle in (estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad))
    found = np.column_stack([estimate.delay_s + late, *sines])[~estimate.is_weak]
    true = np.column_stack([paths.delay_s, paths.sin_aod, paths.sin_aoa])
    if not len(found):
        return np.full(true.shape, np.inf)
    off = (found[:, None] - true) / bound
    nearest = np.square(off).sum(axis=2).argmin(axis=0)
    ratio = off[nearest, np.arange(len(true))]
    return np.asarray(np.where((np.abs(ratio) > FAR).any(axis=1)[:, None], np.inf, ratio))


def joint_bound(paths: PlaneWaves, noise: float, time_s: FloatArray) -> FloatArray:
    """Bounds (path, parameter) of delay and both sines; gains, frequency and drift are unknown as well.

    From derivatives by central differences of the model of independent.py; delays are those in mid-sweep.
    """
    k = np.arange(other.N_SUBCARRIERS) - other.N_SUBCARRIERS // 2
    time_s = time_s - time_s.mean()
    n = len(paths.delay_s)

    def model(state: FloatArray) -> FloatArray:
        delay, aod, aoa, real, imag = state[:-2].reshape(5, n)
        tx, rx = other.responses(other.N_TX, aod), other.responses(other.N_RX, aoa)
        wave = np.exp(-2j * np.pi * np.outer(1e-9 * delay, k) * other.SPACING_HZ)
        clean = np.einsum("p,tp,rp,pk->trk", real + 1j * imag, tx, rx, wave)
        turn = state[-2] * time_s[..., None] - 1e-6 * state[-1] * time_s[..., None] * k * other.SPACING_HZ
        return np.asarray((clean * np.exp(2j * np.pi * turn)).ravel())

    gains = paths.amplitude.real, paths.amplitude.imag
    state = np.concatenate([1e9 * paths.delay_s, paths.sin_aod, paths.sin_aoa, *gains, [0.0, 0.0]])
    step = 1e-5
    columns = [(model(state + step * row) - model(state - step * row)) / (2 * step) for row in np.eye(len(state))]
    jacobian = np.stack(columns, axis=1)
    power = noise**2 / other.SIZE * other.N_SUBCARRIERS / other.COMB  # of a resource element of the sweep
    covariance = np.linalg.inv(2 * (jacobian.conj().T @ jacobian).real / power)
    std = np.sqrt(np.diagonal(covariance))[: 3 * n].reshape(3, n).T
    return np.asarray(std * [1e-9, 1.0, 1.0])
