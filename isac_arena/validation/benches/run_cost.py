"""What a run of a campaign costs: the record, its table, and the page docs/performance.md."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from isac_arena.validation.measurement import InfoTable

STAGES = {
    "plan": "plan and doubts",
    "trace": "rays, with the truth",
    "samples": "samples of the sweeps",
    "channel": "channel estimates",
    "maps": "mapping, SLAM and contours",
    "scores": "scores",
    "report": "figures and report",
    "files": "lock, manifest and hashes",
}
COLUMNS = ("stage", "s", "s per stop", "FFT passes per stop", "share")


@dataclass(frozen=True)
class RunCost:
    """Processor times of a campaign on one core, in s, and the floor of the machine.

    Attributes
    ----------
    trace_s, samples_s : of the truths and of the samples of all stops alone, in memory
    stages_s : of every stage of a whole run, keys as in `STAGES`
    pass_s, copy_s : of an FFT pass over the samples of a stop, and of a copy of them
    samples_mb : size of the samples of a stop
    peak_mb : largest resident memory of the process until the end of the run
    """

    name: str
    n_stops: int
    trace_s: float
    samples_s: float
    stages_s: Mapping[str, float]
    pass_s: float
    copy_s: float
    samples_mb: float
    peak_mb: float

    @property
    def run_s(self) -> float:
        """Time of the whole run."""
        return sum(self.stages_s.values())

    @property
    def generation_s(self) -> float:
        """Time of truths and samples alone."""
        return self.trace_s + self.samples_s

    @property
    def run_over_generation(self) -> float:
        """Time of the run over that of its generation alone."""
        return self.run_s / self.generation_s

    @property
    def estimation_s(self) -> float:
        """Time of channel estimates and maps."""
        return self.stages_s["channel"] + self.stages_s["maps"]

    @property
    def scoring_s(self) -> float:
        """Time of scores and report."""
        return self.stages_s["scores"] + self.stages_s["report"]

    @property
    def scoring_share(self) -> float:
        """Time of scores and report over that of estimation."""
        return self.scoring_s / self.estimation_s


def stage_table(cost: RunCost) -> InfoTable:
    """Every stage of a run, the whole run, and its generation alone, by `COLUMNS`."""
    named = {STAGES[stage]: time_s for stage, time_s in cost.stages_s.items()}
    named |= {"whole run": cost.run_s, "rays and samples alone": cost.generation_s}
    rows = tuple(
        (name, time_s, time_s / cost.n_stops, time_s / cost.n_stops / cost.pass_s, f"{time_s / cost.run_s:.1%}")
        for name, time_s in named.items()
    )
    return InfoTable(f"{cost.name}, {cost.n_stops} stops, one core", COLUMNS, rows)


def performance_page(costs: Sequence[RunCost]) -> str:
    """The costs of some campaigns as a page in Markdown."""
    floors = [
        (
            cost.name, f"{cost.samples_mb:.0f} MB", f"{1e3 * cost.pass_s:.1f} ms", f"{1e3 * cost.copy_s:.1f} ms",
            f"{cost.peak_mb:,.0f} MB",
        )
        for cost in costs
    ]  # fmt: skip
    floor = _markdown(("campaign", "samples of a stop", "FFT pass", "copy", "peak memory of the run"), floors)
    return PAGE.format(n_cores=os.cpu_count(), floor=floor, campaigns="\n".join(map(_section, costs)).rstrip())


def _section(cost: RunCost) -> str:
    """The stages of a campaign, and what they add up to."""
    table = stage_table(cost)
    rows = [
        (str(name), f"{s:.2f}", f"{each:.3f}", f"{passes:.3g}", str(share))
        for name, s, each, passes, share in table.rows
    ]
    slowest = max(cost.stages_s, key=lambda stage: cost.stages_s[stage])
    return (
        f"## {table.title}\n\n{_markdown(table.columns, rows)}\n\n"
        f"The run takes {cost.run_over_generation:.1f} times its rays and samples alone. The largest part is"
        f" {STAGES[slowest]}: {cost.stages_s[slowest] / cost.run_s:.0%}.\nScores and report take"
        f" {cost.scoring_share:.1%} of the estimation.\n"
    )


def _markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown, numbers to the right."""
    lines = [columns, ("---", *["---:"] * (len(columns) - 1)), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


PAGE = """# Performance

What a campaign costs, stage by stage. `arena bench campaign --page docs/performance.md` measures it again and
writes this page. The same numbers are printed beside the bars of the command.

All times are processor times of one process on a machine with {n_cores} cores. Numerical code has one thread; what
the ray tracer's own threads take is counted. Libraries are loaded and code is compiled before: a first run of
`box_room` pays for that. The run makes the calls of `arena run`. Several workers make stops side by side, then
mapping beside SLAM.

## The floor

The samples of a stop are what every estimator has to read. An FFT pass over them, along the subcarriers, is the
least that an estimator of paths does; a copy is the least that anything does which touches them. Times in FFT
passes change less from machine to machine than seconds do. Other work on a machine slows both down.

{floor}

The peak is that of the whole process by then, with all libraries and what the runs before it left.

{campaigns}

"Rays and samples alone" are the same calls in memory, with nothing estimated or written: what a user pays who
brings an estimator of his own.

## What the time depends on

- **Paths.** The coherent fit solves all paths of a stop jointly, so its time grows faster than their number.
  `channel.maximum_likelihood.max_paths` limits it. `arena bench channel` has the fit at 30, 60, 120 and 240 paths
  (`channel.dense`).
- **Samples.** Beams times subcarriers: `waveform.n_rb`, `waveform.comb`, `beams_per_panel` and panels.
- **Rays.** `propagation.max_bounces`, `propagation.diffuse_samples` and `propagation.diffraction`.
- **Stops.** Rays, samples and channel estimates of a stop depend on no other stop; SLAM and contours take all
  together.

`channel.method = "power"` is by far the fastest method of channel estimation, and the coarsest.

## Where the time goes in your run

Python's own profiler needs no installation. It slows small functions down, so trust its shares, not its seconds:

```sh
OMP_NUM_THREADS=1 python -m cProfile -o out/run.prof -m isac_arena run box_room --out out/profiled --workers 1
python -m pstats out/run.prof          # then: sort cumulative, stats 40
```

A flame graph is drawn by a sampling profiler, [py-spy](https://github.com/benfred/py-spy), which is no dependency
of the project (`pip install py-spy`). It sees compiled functions under the name of the Python function that calls
them:

```sh
py-spy record -o out/flame.svg -- arena run box_room --out out/flamed --workers 1
py-spy record -f speedscope -o out/run.speedscope.json -- arena run box_room --out out/scoped --workers 1
```

The first is opened in a browser, the second in [speedscope](https://www.speedscope.app). Each needs a new `--out`:
a finished run has nothing left to do. Git ignores `out/`.
"""
