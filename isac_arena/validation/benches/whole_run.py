"""`arena bench campaign`: a whole run over its generation alone, and the costs that docs/performance.md shows.

Generation is the truth and the samples of every stop, in memory. The run makes the calls of `arena run` one by
one, so that each stage has a time of its own. All times are processor times of one process with one thread;
libraries are loaded and code is compiled by a first run of a small room.
"""

import io
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import scipy.fft

from isac_arena.campaign import stages
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.chain.halls import make_halls
from isac_arena.campaign.shards import STOPS_A_SHARD
from isac_arena.campaign.stored import pack_stops
from isac_arena.validation.benches.campaign import QUICK_STOPS, SMALL, box_campaign
from isac_arena.validation.benches.run_cost import RunCost, performance_page, stage_table
from isac_arena.validation.benches.sweep import peak_memory_mb
from isac_arena.validation.measurement import Measured, at_most
from isac_arena.workers.stops import campaign_run
from isac_arena.workers.threads import one_thread
from scenes.record import ComplexArray, FloatArray

T = TypeVar("T")

MOST_GENERATIONS = 3.0  # a run may take
MOST_SHARE = 0.1  # of scores and report over estimation: they only look at what is there
FLOOR_REPEATS = 20  # FFT passes and copies before the run, and as many after it


def bench_whole_run(seed: int, quick: bool, page: Path | None = None) -> Measured:
    """Rows of campus_arena, costs of box_room and campus_arena; quick: of a small room alone.

    `page` is the Markdown file that shows the costs.
    """
    if quick:
        campaigns = [box_campaign(seed, QUICK_STOPS, SMALL)]
    else:
        campaigns = [load_campaign(name, seed=seed) for name in ("box_room", "campus_arena")]
    with one_thread():
        run_stages(campaigns[0])
        costs = [run_cost(campaign) for campaign in campaigns]
    if page is not None:
        page.write_text(performance_page(costs), encoding="utf-8")
    last = costs[-1]
    run = f"{last.name}, {last.n_stops} stops: {last.run_s:.1f} s over {last.generation_s:.1f} s"
    after = f"{last.scoring_s:.2f} s over {last.estimation_s:.1f} s, of channel and maps"
    rows = [
        at_most("campaign.run_over_generation", last.run_over_generation, MOST_GENERATIONS, run, "generations"),
        at_most("campaign.score_and_report_share", last.scoring_share, MOST_SHARE, after, "of estimation"),
    ]
    return Measured(rows, tuple(map(stage_table, costs)))


def run_cost(campaign: Campaign) -> RunCost:
    """The cost of a campaign: its generation alone, then a whole run between two measurements of the floor."""
    trace_s, samples_s, samples = generation(campaign)
    before = floor(samples)
    stages_s = run_stages(campaign)
    pass_s, copy_s = np.median(np.concatenate([before, floor(samples)]), axis=0).tolist()
    size_mb = 1e-6 * samples.nbytes
    return RunCost(
        campaign.config.name, len(campaign.stops), trace_s, samples_s, stages_s, pass_s, copy_s, size_mb,
        peak_memory_mb(),
    )  # fmt: skip


def generation(campaign: Campaign) -> tuple[float, float, ComplexArray]:
    """Seconds of all truths and of all samples, nothing estimated or written, and the samples of the last stop."""
    run, times_s = campaign.chain(), dict.fromkeys(("trace", "samples"), 0.0)
    for stop in run.chosen_stops:
        truth = timed(times_s, "trace", partial(run.truth, stop))
        sweep = timed(times_s, "samples", partial(run.sweep, truth))
    return times_s["trace"], times_s["samples"], sweep.samples


def run_stages(campaign: Campaign, out: Path | None = None, *, maps: bool = True) -> dict[str, float]:
    """Seconds of every stage of a run in the order of `arena run`, or of those before the maps.

    `out` is the directory of the run; without, it has one for the moment.
    """
    times_s: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        started = time.process_time()
        with redirect_stdout(io.StringIO()), stages.opened(campaign, out or Path(folder, "run"), None) as store:
            plan = timed(times_s, "plan", partial(stages.run_plan, store))
            run = campaign_run(store)
            for stop in run.chosen_stops:
                truth = timed(times_s, "trace", partial(run.truth, stop))
                sweep = timed(times_s, "samples", partial(run.sweep, truth))
                timed(times_s, "channel", partial(run.estimate, truth, sweep))
                if stop % STOPS_A_SHARD == 0:
                    pack_stops(store)
            pack_stops(store)
            timed(times_s, "channel", partial(make_halls, run, again=True))
            if maps:
                timed(times_s, "maps", partial(stages.build_maps, store))
                timed(times_s, "scores", partial(stages.write_scores, store))
                timed(times_s, "report", partial(stages.write_report, store, plan))
        times_s["files"] = time.process_time() - started - sum(times_s.values())
    return times_s


def floor(samples: ComplexArray) -> FloatArray:
    """Seconds (repeat, 2) of an FFT pass over the subcarriers of a stop's samples, and of a copy of them."""
    works: tuple[Callable[[], object], ...] = (partial(scipy.fft.fft, samples, axis=-1), samples.copy)
    times_s = np.empty((FLOOR_REPEATS, len(works)))
    for repeat in range(FLOOR_REPEATS):
        for k, work in enumerate(works):
            started = time.process_time()
            work()
            times_s[repeat, k] = time.process_time() - started
    return times_s


def timed(times_s: dict[str, float], stage: str, work: Callable[[], T]) -> T:
    """What the work returns; its processor time is added to that of the stage."""
    started = time.process_time()
    value = work()
    times_s[stage] = times_s.get(stage, 0.0) + time.process_time() - started
    return value
