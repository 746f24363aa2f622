"""`arena validate scoring`: errors over their bounds, and the causes of false and missed paths."""

from dataclasses import replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.plane import range_covariance
from estimation.slam.bounds import StateBound, StopPaths, state_covariance, stop_information
from isac_arena.campaign.results import CampaignResults
from isac_arena.scoring.causes import FALSE_CAUSES, MISS_CAUSES, Cause
from isac_arena.scoring.config import DEFAULT_GATE, Significance
from isac_arena.scoring.link_view import Cells, LinkView
from isac_arena.scoring.record import PathStatus
from isac_arena.scoring.stages.channel import score_stop
from isac_arena.scoring.stages.channel_metrics import channel_metrics
from isac_arena.scoring.stages.poses import pose_bounds, pose_metrics, score_poses
from isac_arena.scoring.true_stop import TrueStop, true_stop
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.estimates import moved_poses, shift_estimate, true_states
from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, made_view, make_campaign
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, concatenate
from sim.signal.generation import beam_channel
from sim.signal.link import best_beam_power_dbm
from sim.truth import Truth

LIMITS = Significance(dynamic_range_db=60.0, noise_threshold_dbm=-300.0)
DETECTABLE = 6  # the line of sight, four single bounces and a double one


def check_bounds(seed: int, quick: bool) -> list[Measurement]:
    """An efficient estimator: its errors are drawn from the bounds, so their RMS over the bounds is 1."""
    made = make_campaign()
    stops = _stops(made, made_view())
    bound = pose_bounds(made.scene, [[stop] for stop in stops])
    rng = np.random.default_rng(seed)
    runs = 15 if quick else 300
    values: dict[str, list[float]] = {}
    for _ in range(runs):
        for key, value in _over_bound(stops, bound, _efficient(made, stops, rng)).items():
            values.setdefault(key, []).append(value)
    state = np.array([_state_covariance(made, stop) for stop in stops])
    bars = dict.fromkeys(("delay", "aod", "aoa"), 4 / np.sqrt(2 * runs * len(stops) * DETECTABLE))
    bars |= {
        name: 4 * _relative_deviation(state[:, rows][:, :, rows]) / np.sqrt(runs)
        for name, rows in (("position", [0, 1]), ("heading", [2]), ("clock", [3]))
    }
    ends = {name: f"channel.{name}.over_bound.rms" for name in ("delay", "aod", "aoa")}
    found = {name: values[ends.get(name, f"slam.{name}.over_bound")] for name in bars}
    return [
        _row(f"over_bound.{name}", np.sqrt(np.mean(np.square(found[name]))) - 1, bar) for name, bar in bars.items()
    ]


def _relative_deviation(covariance: FloatArray) -> float:
    """Standard deviation of the RMS of one draw of all stops, over it; `covariance` is (stop, k, k).

    A squared Gaussian error has variance 2 tr(C^2), and a root half the relative deviation of its square.
    """
    variance = 2 * np.einsum("sij,sji->", covariance, covariance)
    return float(np.sqrt(variance) / np.einsum("sii->", covariance) / 2)


def check_causes(seed: int, quick: bool) -> list[Measurement]:
    """Causes found for faults made on purpose, leaked power against samples, and one cause for every fault."""
    made, view = make_campaign(), made_view()
    rng = np.random.default_rng(seed)
    wrong = unnamed = 0
    stops = _stops(made, view)
    for stop, estimate in zip(stops, made.results.channel, strict=True):
        for cause, faulty_stop, faulty in _faults(stop, view, estimate, rng):
            paths, true_paths, _ = score_stop(faulty_stop, faulty)
            false = paths.cause[paths.status == PathStatus.FALSE]
            missed = true_paths.cause[~true_paths.is_detected]
            wrong += cause not in {*false, *missed}
            unnamed += int((~np.isin(false, FALSE_CAUSES)).sum() + (~np.isin(missed, MISS_CAUSES)).sum())
    leak_db = max(_leak_error_db(stop.truth, view, rng) for stop in stops[: 2 if quick else len(stops)])
    return [
        _row("causes.wrong", wrong, 0, "faults made on purpose with another cause in the scores"),
        _row("causes.unnamed", unnamed, 0, "false or missed paths without a cause, 'unknown' is one"),
        _row("causes.leak", leak_db, 1e-2, "leaked power against samples of a lone path", "dB"),
    ]


def _power_dbm(made: MadeCampaign, view: LinkView, truth: Truth) -> FloatArray:
    return best_beam_power_dbm(truth.paths, view.link, made.scene.tx, truth.rx_pose)


def _stops(made: MadeCampaign, view: LinkView) -> list[TrueStop]:
    return [true_stop(truth, made.scene.tx, _power_dbm(made, view, truth), LIMITS, view) for truth in made.truths]


def _efficient(made: MadeCampaign, stops: list[TrueStop], rng: np.random.Generator) -> CampaignResults:
    """The made results with path parameters and poses off by draws from their bounds."""
    channel, errors = [], []
    for stop, estimate in zip(stops, made.results.channel, strict=True):
        channel.append(
            shift_estimate(estimate, [rng.multivariate_normal(np.zeros(3), one) for one in stop.covariance])
        )
        errors.append(rng.multivariate_normal(np.zeros(4), _state_covariance(made, stop)))
    moved = moved_poses(made.results.slam.poses, np.array(errors) / [1.0, 1.0, 1.0, SPEED_OF_LIGHT_M_S])
    return replace(made.results, channel=tuple(channel), slam=replace(made.results.slam, poses=moved))


def _state_covariance(made: MadeCampaign, stop: TrueStop) -> FloatArray:
    """Bound (4, 4) in (m, m, rad, m) of a stop whose first paths are the line of sight and four single bounces."""
    covariance = range_covariance(stop.covariance)
    state = true_states([stop.truth])[0] * [1.0, 1.0, 1.0, SPEED_OF_LIGHT_M_S]
    paths = StopPaths(stop.origin.vertex_m[1:5], covariance[1:5], np.full(4, -1), covariance[0])
    return state_covariance(stop_information(made.scene.tx, state, paths))


def _over_bound(stops: list[TrueStop], bound: StateBound, results: CampaignResults) -> dict[str, float]:
    parts = [score_stop(stop, one) for stop, one in zip(stops, results.channel, strict=True)]
    paths, significant, sets = zip(*parts, strict=True)
    truths = [stop.truth for stop in stops]
    number, bias_s = np.array([one.stop for one in truths]), np.array([one.clock_bias_s for one in truths])
    rx, has_los = [one.rx_pose for one in truths], np.ones(len(truths), bool)
    poses = score_poses(number, rx, bias_s, has_los, results.slam.poses, bound)
    metrics = channel_metrics(
        concatenate(sets, "stop"), concatenate(paths, "estimate"), concatenate(significant, "true_path")
    )
    return {metric.key: metric.value for metric in metrics + pose_metrics(poses)}


def _faults(
    stop: TrueStop, view: LinkView, estimate: ChannelEstimate, rng: np.random.Generator
) -> list[tuple[Cause, TrueStop, ChannelEstimate]]:
    """Estimates with one fault each, the stop they are of, and the cause that must be named.

    The paths varied are those off the second pillar and the last wall, beside which there is no diffuse energy.
    """
    gate = DEFAULT_GATE.half_width
    path = int(rng.choice([2, 4]))
    extra = estimate.take("path", [path])
    other = estimate.take("path", np.arange(len(estimate)) != path)
    again = shift_estimate(extra, [0.3 * gate[0], 0.0, 0.0])
    beside = shift_estimate(extra, [rng.uniform(1.2, 1.8) * gate[0], 0.0, 0.0])
    nowhere = shift_estimate(extra, [60e-9, 0.0, 0.9])
    loud = replace(nowhere, power_dbm=np.zeros(1))
    noisy = replace(stop, limits=stop.limits.model_copy(update={"noise_threshold_dbm": -1.0}))
    aoa = np.linspace(-np.pi, np.pi, 181)
    strongest = estimate.take("path", np.zeros(181, int))
    probe = replace(strongest, aoa_azimuth_rad=aoa, is_los=np.zeros(181, bool))
    leaked = view.leaked_dbm(stop.truth, view.estimated_cells(probe))[:, 0]
    far = np.abs(np.angle(np.exp(1j * (aoa - estimate.aoa_azimuth_rad[0])))) > np.deg2rad(25)
    at = int(np.where(far, leaked, -np.inf).argmax())
    lobe = replace(probe.take("path", [at]), power_dbm=leaked[[at]])
    return [
        (Cause.DUPLICATE, stop, concatenate([estimate, again], "path")),
        (Cause.INACCURATE, stop, concatenate([other, beside], "path")),
        (Cause.SIDE_LOBE, stop, concatenate([estimate, lobe], "path")),
        (Cause.NOISE, noisy, concatenate([estimate, loud], "path")),
        (Cause.UNKNOWN, stop, concatenate([estimate, loud], "path")),
    ]


def _leak_error_db(truth: Truth, view: LinkView, rng: np.random.Generator) -> float:
    """Largest error of leaked powers within 60 dB of a lone path, against its samples."""
    link, n = view.link, 200
    alone = replace(truth, paths=truth.paths.take("path", [int(rng.integers(0, len(truth.paths)))]))
    delay_s = alone.paths.delay_s[0] + truth.clock_bias_s + rng.normal(0, 5e-9, n)
    cells = Cells(delay_s, *(rng.integers(0, len(book), n) for book in (link.tx_codebook, link.rx_codebook)))
    samples = beam_channel(
        alone.paths, tx_codebook=link.tx_codebook, rx_codebook=link.rx_codebook, tx_pose=view.tx_pose,
        rx_pose=truth.rx_pose, frequency_offset_hz=link.frequency_offset_hz, clock_bias_s=truth.clock_bias_s,
    )  # fmt: skip
    wave = np.exp(2j * np.pi * delay_s[:, None] * link.frequency_offset_hz) * view.window
    seen = np.abs((samples[cells.tx_beam, cells.rx_beam] * wave).sum(axis=1) / view.window.sum()) ** 2
    seen_dbm = 10 * np.log10(np.maximum(seen * link.tx_power_mw, 1e-300))
    leaked_dbm = view.leaked_dbm(alone, cells)[:, 0]
    strong = leaked_dbm > leaked_dbm.max() - 60
    return float(np.abs(seen_dbm - leaked_dbm)[strong].max())


def _row(
    key: str, value: float, bar: float, reason: str = "4 standard deviations", unit: str = "1"
) -> Measurement:
    return at_most(f"scoring.{key}", abs(float(value)), bar, reason, unit)
