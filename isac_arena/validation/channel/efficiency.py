"""`arena validate channel`: efficiency, detection, false paths and consistency on made stops.

Without an estimator of the user's, rows that start with the name of a method check that method. A user's estimator
replaces all of them, and then has to work with random phases as well.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from estimation.channel.estimate import estimate_channel
from isac_arena.campaign.chain import user_estimator
from isac_arena.validation.channel.match import (
    Estimator,
    MatchedPaths,
    consistency_rows,
    efficiency_rows,
    estimate_places,
    false_row,
    rate_row,
    run_stops,
)
from isac_arena.validation.measurement import Measurement
from isac_arena.validation.scenarios.link_bench import (
    SEPARATED_CELLS,
    ChannelStop,
    DrawnPaths,
    LinkBench,
    draw_paths,
    equal_pair,
    make_bench,
    observe_paths,
    single_path,
)

TRIALS = 5000  # scenes of the coherent run; the bar on false paths asks for as many
QUICK_TRIALS = 20
STRONGEST_DB = (20.0, 40.0)
UNIFORM_DEG = 180.0  # step of the phase from pair to pair: wrapped, it is uniform to 1 %
RESOLVED_CELLS = 0.5


def make_estimator(method: str, estimator: str | None) -> Estimator:
    """A method of ours by name, or the user's `package.module:function` in its place."""
    if estimator is not None:
        return user_estimator(estimator)
    return lambda sweep: estimate_channel(sweep, method=method)


def scaled(trials: int | None, quick: bool, share: float) -> int:
    """Trials of a check that takes a share of the longest run."""
    whole = trials or (QUICK_TRIALS if quick else TRIALS)
    return max(3, round(share * whole))


def check_coherent_scenes(
    seed: int, quick: bool, trials: int | None = None, estimator: str | None = None
) -> list[Measurement]:
    """Random scenes with phases kept: efficiency, detection, false paths and consistency."""
    bench = make_bench(seed)
    stops = scene_stops(bench, seed, scaled(trials, quick, 1.0))
    estimate = make_estimator("coherent", estimator)
    return _scene_rows(
        "coherent", run_stops(bench, stops, estimate, coherent=True), (1.10, 1.05), 10, 9, quick
    )


def check_incoherent_scenes(
    seed: int, quick: bool, trials: int | None = None, estimator: str | None = None
) -> list[Measurement]:
    """Random scenes with a random phase on every beam pair, against the bound of that."""
    bench = make_bench(seed, phase_noise_pair_deg=UNIFORM_DEG)
    stops = scene_stops(bench, seed + 1, scaled(trials, quick, 0.2 if not quick else 0.5))
    estimate = make_estimator("incoherent", estimator)
    return _scene_rows(
        "incoherent", run_stops(bench, stops, estimate, coherent=False), (1.10, 1.10), 12, 11, quick
    )


def _scene_rows(
    method: str, table: MatchedPaths, bars: tuple[float, float], sharp_db: float, found_db: float, quick: bool
) -> list[Measurement]:
    """All rows of random scenes: errors are scored from `sharp_db` on, detection from `found_db` on.

    `bars` are those of every RMSE over its bound and of their mean.
    """
    return [
        *efficiency_rows(
            method, table, min_snr_db=sharp_db, min_separation=SEPARATED_CELLS, bars=bars, quick=quick
        ),
        *consistency_rows(method, table, min_snr_db=sharp_db, min_separation=SEPARATED_CELLS, quick=quick),
        rate_row(
            f"{method}.detection.scenes", table.is_found[table.identifiable(found_db)], 0.99,
            f"known as well as lone ones from {found_db:g} dB on", quick,
        ),
        false_row(f"{method}.false_per_stop", table.n_false, 1e-3, quick),
    ]  # fmt: skip


def check_detection(
    seed: int, quick: bool, trials: int | None = None, estimator: str | None = None
) -> list[Measurement]:
    """A lone path at the lowest SNR that has to be found."""
    rows = []
    for method, snr_db, phase_deg in (("coherent", 9.0, 0.0), ("incoherent", 11.0, UNIFORM_DEG)):
        bench = make_bench(seed, phase_noise_pair_deg=phase_deg)
        rng = np.random.default_rng([seed, 2])
        stops = (
            observe_paths(bench, single_path(rng, snr_db), stop) for stop in range(scaled(trials, quick, 0.4))
        )
        table = run_stops(bench, stops, make_estimator(method, estimator), coherent=method == "coherent")
        rows.append(
            rate_row(f"{method}.detection.lone_{snr_db:g}db", table.is_found, 0.99, "lone paths", quick)
        )
    return rows


def check_resolution(
    seed: int, quick: bool, trials: int | None = None, estimator: str | None = None
) -> list[Measurement]:
    """Two equal paths of random phases 0.4 Rayleigh cell apart on one axis, 30 dB each."""
    bench = make_bench(seed)
    estimate = make_estimator("coherent", estimator)
    rows = []
    for axis, name in enumerate(("delay", "aod", "aoa")):
        rng = np.random.default_rng([seed, 3, axis])
        hits = []
        for stop in range(scaled(trials, quick, 0.1)):
            paths = equal_pair(rng, bench.cell, axis=axis, cells=0.4, snr_db=30.0)
            made = observe_paths(bench, paths, stop)
            hits.append(is_resolved(bench, made, estimate))
        rows.append(
            rate_row(
                f"coherent.resolved.{name}", np.array(hits), 0.9, "two paths found, half a cell near", quick
            )
        )
    return rows


def is_resolved(bench: LinkBench, stop: ChannelStop, estimate: Estimator) -> bool:
    """Whether two paths and no others are found, each within half a cell of its own true path on every axis."""
    places = estimate_places(estimate(stop.sweep))
    if len(places) != 2:
        return False
    apart = np.abs(places[:, None] - stop.paths.cells) / bench.cell
    near = np.asarray((apart <= RESOLVED_CELLS).all(axis=2))
    return bool((near[0, 0] and near[1, 1]) or (near[0, 1] and near[1, 0]))


def scene_stops(bench: LinkBench, seed: int, count: int) -> Iterator[ChannelStop]:
    """Random stops, the same for every estimator."""
    for stop in range(count):
        yield observe_paths(bench, scene_paths(bench, seed, stop), stop)


def scene_paths(bench: LinkBench, seed: int, stop: int) -> DrawnPaths:
    """The paths of one random stop."""
    return draw_paths(np.random.default_rng([seed, stop]), bench.cell, strongest_db=STRONGEST_DB)
