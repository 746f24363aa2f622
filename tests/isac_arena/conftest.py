from collections.abc import Callable, Iterator
from pathlib import Path

import dask.config
import pytest
from distributed.utils import get_mp_context

from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, make_campaign, power_dbm
from scenes.record import FloatArray
from sim.truth import Truth
from tests.command_line import arena_here
from tests.isac_arena.cli.sweep_files import N_CASES, write_sweep

LIBRARIES = ("isac_arena.workers.cluster", "isac_arena.campaign.driver", "sim.propagation.propagator")


@pytest.fixture(scope="session", autouse=True)
def forked_workers() -> Iterator[None]:
    """Sweeps in this process fork their workers from one with the libraries imported: 0.1 s instead of 3 s each.

    The tests of kills start workers as a user does.
    """
    with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
        get_mp_context().set_forkserver_preload(["isac_arena.sweep.engine", *LIBRARIES])
        yield


@pytest.fixture(scope="session")
def campaign() -> MadeCampaign:
    return make_campaign()


@pytest.fixture(scope="session")
def true_power() -> Callable[[Truth], FloatArray]:
    return power_dbm


@pytest.fixture
def truths(campaign: MadeCampaign) -> Iterator[Truth]:
    return iter(campaign.truths)


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of the smallest campaign, which ran to its report in `run`; tests change copies."""
    folder = tmp_path_factory.mktemp("finished")
    write_sweep(folder)
    result = arena_here("run", "small.toml", "--out", "run", cwd=folder)
    assert result.returncode == 0, result.stderr
    return folder


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sweep of `N_CASES` cases that ran to its end on one worker."""
    folder = tmp_path_factory.mktemp("undisturbed")
    write_sweep(folder, repeats=N_CASES // 2)
    result = arena_here("sweep", "sweep.toml", "--out", "out", "--workers", "1", cwd=folder)
    assert result.returncode == 0, result.stderr
    return folder
