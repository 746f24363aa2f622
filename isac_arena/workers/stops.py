"""The stops of a campaign side by side: truth, samples and channel estimate of each, in the files of a directory.

Whoever makes a stop writes its files, so workers only say how it ended. Every stop has its own random numbers and
all processes compute with one thread: the files have the same bytes for any number of workers.
"""

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TypeVar

from isac_arena.campaign.campaign import link_stores
from isac_arena.campaign.directory import CampaignStore, open_campaign
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.summary import TraceCounts, trace_counts
from isac_arena.user_functions.config import UserFunctions
from isac_arena.user_functions.errors import EstimatorError
from isac_arena.workers.workers import Workers, n_cores
from scenes.memory import MemoryLimitError, limited_memory, memory_limit_bytes
from sim.signal.demand import sample_bytes

# Measured: two workers take 5 s to start on two free cores, 10 s on busy ones, 2 s to end, and their first stops
# take longer. Like `FIRST_S` it decides who makes a stop, and no result depends on it.
START_S = 15.0
FIRST_S = 10.0  # that the first stop here may take longer than the next: it imports, and loads compiled code
IMPORT_S = 60.0  # that a function of a user may take to be imported, beside its call
WORKER_BYTES = 600e6  # of a worker without samples
DIED = (
    "stop {stop}: its worker died each time: out of memory, crashed, or longer than --stop-limit; the other stops "
    "stay, the same command continues"
)

Tell = Callable[[str], None]
T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class StopWork:
    """What is made at the stops of a directory. Small, because it is sent to the workers."""

    directory: Path
    side: Path | None
    functions: str  # of a user, as JSON
    keeps_sweeps: bool
    estimates: bool  # makes channel estimates where there are none
    again: bool  # also where there are some

    @property
    def store(self) -> CampaignStore:
        """The directory, opened in a worker."""
        store = open_campaign(self.directory)
        config = store.config.model_copy(update={"functions": UserFunctions.model_validate_json(self.functions)})
        return replace(store, config=config, side=self.side)


@dataclass(frozen=True)
class MadeStop:
    """How a stop ended: the counts of its planar paths, and the error of a user's function that failed there."""

    counts: TraceCounts
    failure: EstimatorError | None = None


class StopMakers:
    """Who makes the stops: at most `workers` processes, one per core by default; one is this process.

    A worker that takes longer than `limit_s` for a stop is ended, by default after an hour. Workers start where
    they save more than `start_s`, by default `START_S`. As a context they stay for what follows until its end.
    """

    def __init__(
        self, workers: int | None = None, limit_s: float | None = None, start_s: float | None = None
    ) -> None:
        self.workers, self.limit_s, self.start_s = workers, limit_s, start_s
        self._started: Workers | None = None
        self._stack = ExitStack()

    def __enter__(self) -> "StopMakers":
        return self

    def __exit__(self, *error: object) -> None:
        self._started = None
        self._stack.close()

    def start(self, n_workers: int) -> Workers:
        """Start so many workers, unless there are some."""
        if self._started is None:
            self._started = self._stack.enter_context(Workers(n_workers, None))
            self._started.start()
        return self._started

    def begun(self, function: Callable[[T], R], item: T) -> Callable[[], R | BaseException] | None:
        """Call a function on one worker, and end the others; what comes back waits for the outcome.

        None where there are no workers.
        """
        if self._started is None or not self._started.is_ready:
            return None
        from isac_arena.workers.tasks import begun  # noqa: PLC0415  (imports dask)

        self._started.keep(1)
        return begun(self._started.client, function, item)


@dataclass(frozen=True)
class StopRun:
    """The work at the stops of a directory, with the run that does it."""

    store: CampaignStore
    work: StopWork
    failures: list[EstimatorError] = field(default_factory=list)  # of the stop that is being made

    @cached_property
    def run(self) -> CampaignRun:
        """The run: scene, tracer and estimator are loaded once."""
        return campaign_run(self.store, self.failures.append)

    def is_done(self, stop: int) -> bool:
        """Whether all files of a stop are there."""
        work = self.work
        return all(
            store.has_truth(stop)
            and (not work.keeps_sweeps or store.has_sweep(stop))
            and (not work.estimates or (not work.again and store.has_channel(stop)))
            for store, stops in link_stores(self.store)
            if stop in stops
        )

    def make(self, stop: int) -> MadeStop:
        """Make what is missing at a stop, and count its planar paths."""
        self.failures.clear()
        if self.store.measured is not None:
            if not self.is_done(stop) and (recorded := self.store.sweep(stop)) is not None:
                self.run.estimate_sweep(recorded)
            return MadeStop(TraceCounts(), self.failures[0] if self.failures else None)
        counts = TraceCounts()
        for (store, stops), link in zip(link_stores(self.store), self.run.links, strict=True):
            if stop not in stops:
                continue
            counts += self._make(stop, store, link)
        return MadeStop(counts, self.failures[0] if self.failures else None)

    def _make(self, stop: int, store: CampaignStore, link: CampaignRun) -> TraceCounts:
        """The same for one TX."""
        work, truth = self.work, link.truth(stop)
        keeps = work.keeps_sweeps and not store.has_sweep(stop)
        makes = work.estimates and (work.again or not store.has_channel(stop))
        if keeps or makes:
            sweep = link.sweep(truth)
            if keeps:
                store.write_sweep(sweep)
            if makes:
                link.estimate(truth, sweep)
        return trace_counts(truth)


def stop_run(store: CampaignStore, *, keeps_sweeps: bool, estimates: bool, again: bool = False) -> StopRun:
    """The work at the stops of a directory."""
    functions = store.config.functions.model_dump_json()
    return StopRun(store, StopWork(store.directory, store.side, functions, keeps_sweeps, estimates, again))


def campaign_run(store: CampaignStore, on_failure: Callable[[EstimatorError], None] | None = None) -> CampaignRun:
    """The run of the chain that a campaign directory keeps."""
    return CampaignRun(store.config, store.scene, store, on_failure=on_failure)


def make_stops(stops: StopRun, makers: StopMakers, tell: Tell) -> Generator[MadeStop, None, None]:
    """Make what is missing at every stop, and yield how each ends.

    The first stops are made here. Workers start where they save more time than they take to start, judged by the
    stops that were made here, and where the memory holds them. More stops are made here while they start.

    Raises what a stop raises, and `ChildProcessError` where it ended its worker.
    """
    missing = []
    for stop in stops.run.chosen_stops:
        if stops.is_done(stop):
            yield stops.make(stop)
        else:
            missing.append(stop)
    n_workers = min(makers.workers or n_cores(), len(missing))
    n_workers, short = affordable(n_workers, sample_bytes(stops.store.config))
    if missing and short:
        tell(short)
    start_s = START_S if makers.start_s is None else makers.start_s
    times_s: list[float] = []
    while missing and not pays(n_workers, len(missing), times_s, start_s):
        started = time.monotonic()
        made = stops.make(missing.pop(0))
        times_s.append(time.monotonic() - started)
        yield made
    if missing:
        workers = makers.start(n_workers)
        while missing and start_s > 0 and not workers.is_ready:
            yield stops.make(missing.pop(0))
        yield from _made_by_workers(stops, missing, workers, n_workers, makers.limit_s)


def pays(n_workers: int, n_stops: int, times_s: Sequence[float], start_s: float) -> bool:
    """Whether workers save more time than `start_s`, judged by the times of the stops made here so far."""
    if n_workers < 2 or not times_s:
        return False
    later = times_s[1:]
    stop_s = sum(later) / len(later) if later else times_s[0] - FIRST_S
    return (1 - 1 / n_workers) * n_stops * stop_s > start_s


def affordable(n_workers: int, stop_bytes: float) -> tuple[int, str]:
    """How many workers the memory holds, at least one, and a sentence where these are fewer than wanted."""
    limit = memory_limit_bytes()
    fitting = max(1, min(n_workers, int(limit / (WORKER_BYTES + stop_bytes))))
    if fitting == n_workers:
        return n_workers, ""
    each = f"{1e-9 * (WORKER_BYTES + stop_bytes):.2g} GB each, the limit is {1e-9 * limit:.3g} GB (--memory)"
    return fitting, f"processes side by side: {fitting} in place of {n_workers}; they take {each}"


def _made_by_workers(
    stops: StopRun, missing: Sequence[int], workers: Workers, n_workers: int, limit_s: float | None
) -> Iterator[MadeStop]:
    """Make stops on workers; those that found too little memory beside others are made here at the end."""
    from isac_arena.workers.tasks import STOP_LIMIT_S, WorkerDiedError, each_outcome  # noqa: PLC0415  (imports dask)

    share = f"{memory_limit_bytes() / n_workers:.0f}B"
    own = stops.store.config.functions.of("channel")  # it is ended before the worker in which it is called
    limit_s = (limit_s or STOP_LIMIT_S) + (0.0 if own is None else own.limit_s + IMPORT_S)
    calls = [(stops.work, share, stop) for stop in missing]
    short = []
    for (_, _, stop), found in each_outcome(workers.client, n_workers, _made_there, calls, limit_s):
        if isinstance(found, WorkerDiedError):
            raise ChildProcessError(DIED.format(stop=stop))
        if isinstance(found, MemoryLimitError | MemoryError):
            short.append(stop)
        elif isinstance(found, BaseException):
            raise found
        else:
            yield found
    yield from map(stops.make, short)


def _made_there(call: tuple[StopWork, str, int]) -> MadeStop:
    """Make a stop in a worker, with its share of the memory."""
    work, share, stop = call
    with limited_memory(share):
        return _stops_there(work).make(stop)


@lru_cache(maxsize=1)
def _stops_there(work: StopWork) -> StopRun:
    return StopRun(work.store, work)
