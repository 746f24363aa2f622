"""`arena validate channel`: efficiency, detection, false paths and consistency on made stops.

By default, rows that start with the name of a method check that method. An estimator of the user replaces all
methods, and then has to work with random phases too.
"""

from collections.abc import Iterator

import numpy as np

from estimation.channel.estimate import estimate_channel
from isac_arena.campaign.chain.inputs import user_estimator
from isac_arena.validation.channel import matching
from isac_arena.validation.measurement import Measurement
from isac_arena.validation.scenarios import link_bench
from isac_arena.validation.scenarios.link_bench import ChannelStop, LinkBench

TRIALS = 5000  # scenes of the coherent run; the bar on false paths asks for as many
QUICK_TRIALS = 14
STRONGEST_DB = (20.0, 40.0)
UNIFORM_DEG = 180.0  # step of the phase from pair to pair: wrapped, it is uniform to 1 %
RESOLVED_CELLS = 0.5


def make_estimator(method: str, estimator: str) -> matching.Estimator:
    """A method of ours by name, or in its place the user's `package.module:function` if there is one."""
    return (
        user_estimator(estimator) if estimator else lambda sweep: estimate_channel(sweep, method=method).reported
    )


def scaled(trials: int, quick: bool, share: float) -> int:
    """Trials of a check that takes a share of the longest run; 0 `trials` means the default."""
    return max(3, round(share * (trials or (QUICK_TRIALS if quick else TRIALS))))


def check_coherent_scenes(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """Random scenes with phases kept: efficiency, detection, false paths and consistency."""
    bench = link_bench.make_bench(seed)
    stops = scene_stops(bench, seed, scaled(trials, quick, 1.0))
    table = matching.run_stops(bench, stops, make_estimator("coherent", estimator), coherent=True)
    return _scene_rows("coherent", table, (1.10, 1.05), 10, 9, quick)


def check_incoherent_scenes(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """Random scenes with a random phase on every beam pair, against the bound for random phases."""
    bench = link_bench.make_bench(seed, phase_noise_pair_deg=UNIFORM_DEG)
    stops = scene_stops(bench, seed + 1, scaled(trials, quick, 0.5 if quick else 0.2))
    table = matching.run_stops(bench, stops, make_estimator("incoherent", estimator), coherent=False)
    return _scene_rows("incoherent", table, (1.10, 1.10), 12, 11, quick)


def _scene_rows(
    method: str, table: matching.MatchedPaths, bars: tuple[float, float], sharp_db: int, found_db: int, quick: bool
) -> list[Measurement]:
    """All rows of random scenes: errors are scored from `sharp_db` on, detection from `found_db` on.

    `bars` are those of every RMSE over its bound and of their mean.
    """
    found = table.is_found[table.identifiable(found_db)]
    reason = f"known as well as lone ones from {found_db} dB on"
    return [
        *matching.efficiency_rows(method, table, min_snr_db=sharp_db, bars=bars, quick=quick),
        *matching.consistency_rows(method, table, min_snr_db=sharp_db, quick=quick),
        matching.rate_row(f"{method}.detection.scenes", found, 0.99, reason, quick),
        matching.false_row(f"{method}.false_per_stop", table.n_false, 1e-3, quick),
    ]


def check_detection(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """A lone path at the lowest SNR that has to be found."""
    rows = []
    for method, snr_db, phase_deg in (("coherent", 9.0, 0.0), ("incoherent", 11.0, UNIFORM_DEG)):
        bench = link_bench.make_bench(seed, phase_noise_pair_deg=phase_deg)
        rng = np.random.default_rng([seed, 2])
        paths = (link_bench.single_path(rng, snr_db) for _ in range(scaled(trials, quick, 0.4)))
        stops = (link_bench.observe_paths(bench, one, stop) for stop, one in enumerate(paths))
        estimate, key = make_estimator(method, estimator), f"{method}.detection.lone_{snr_db:g}db"
        table = matching.run_stops(bench, stops, estimate, coherent=method == "coherent")
        rows.append(matching.rate_row(key, table.is_found, 0.99, "lone paths", quick))
    return rows


def check_resolution(seed: int, quick: bool, trials: int = 0, estimator: str = "") -> list[Measurement]:
    """Two equal paths of random phases 0.4 Rayleigh cell apart on one axis, 30 dB each."""
    bench = link_bench.make_bench(seed)
    estimate = make_estimator("coherent", estimator)
    rows = []
    for axis, name in enumerate(("delay", "aod", "aoa")):
        rng = np.random.default_rng([seed, 3, axis])
        hits = []
        for stop in range(scaled(trials, quick, 0.1)):
            paths = link_bench.equal_pair(rng, bench.cell, axis=axis, cells=0.4, snr_db=30.0)
            hits.append(is_resolved(bench, link_bench.observe_paths(bench, paths, stop), estimate))
        reason = "two paths found within half a cell"
        rows.append(matching.rate_row(f"coherent.resolved.{name}", np.array(hits), 0.9, reason, quick))
    return rows


def is_resolved(bench: LinkBench, stop: ChannelStop, estimate: matching.Estimator) -> bool:
    """Whether two paths and no others are found, each within half a cell of its own true path on every axis."""
    places = matching.estimate_places(estimate(stop.sweep))
    if len(places) != 2:
        return False
    apart = np.abs(places[:, None] - stop.paths.cells) / bench.cell
    near = np.asarray((apart <= RESOLVED_CELLS).all(axis=2))
    return bool((near[0, 0] and near[1, 1]) or (near[0, 1] and near[1, 0]))


def scene_stops(bench: LinkBench, seed: int, count: int) -> Iterator[ChannelStop]:
    """Random stops, the same for every estimator."""
    for stop in range(count):
        yield link_bench.observe_paths(bench, scene_paths(bench, seed, stop), stop)


def scene_paths(bench: LinkBench, seed: int, stop: int) -> link_bench.DrawnPaths:
    """The paths of one random stop."""
    return link_bench.draw_paths(np.random.default_rng([seed, stop]), bench.cell, strongest_db=STRONGEST_DB)
