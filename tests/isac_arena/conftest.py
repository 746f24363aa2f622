from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, make_campaign, power_dbm
from scenes.record import FloatArray
from sim.truth import Truth
from tests.command_line import arena_here
from tests.isac_arena.cli.sweep_files import N_CASES, write_sweep


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
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sweep of `N_CASES` cases that ran to its end on one worker."""
    folder = tmp_path_factory.mktemp("undisturbed")
    write_sweep(folder, repeats=N_CASES // 2)
    result = arena_here("sweep", "sweep.toml", "--out", "out", "--workers", "1", cwd=folder)
    assert result.returncode == 0, result.stderr
    return folder
