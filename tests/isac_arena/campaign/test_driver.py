"""The driver of the chain: the same results wherever they are kept, for any stops, and with stages replaced."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import isac_arena as ia
from estimation.channel.config import ChannelConfig, SelfCalibrationConfig
from estimation.slam.record import SolveStatus
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.campaign.chain.memory import MemoryRun, RunResults
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import CampaignStore
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import MemoryResults
from isac_arena.scoring.score import Scores
from isac_arena.user_functions.config import with_functions
from isac_arena.verification.compare import compare_records
from scenes.scene import Scene
from sim.observation import BeamSweep
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.link import Link
from sim.simulate import observe
from sim.truth import Truth
from tests.isac_arena.cli.sweep_files import CAMPAIGN

STOPS = (0, 1, 3)
MODULE = """
from estimation.channel.power.paths import estimate_power


def strongest(sweep):
    return estimate_power(sweep).take("path", slice(0, 3))
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    file = tmp_path_factory.mktemp("driver") / "small.toml"
    file.write_text(CAMPAIGN)
    return load_campaign(file, slam={"method": "statistical"})


@pytest.fixture(scope="module")
def in_memory(loaded: Campaign) -> CampaignRun:
    return loaded.chain(STOPS)


@pytest.fixture(scope="module")
def scores(in_memory: CampaignRun) -> Scores:
    return in_memory.scores()


def same(one: Scores, other: Scores) -> bool:
    values = [np.array([metric.value for metric in found.metrics]) for found in (one, other)]
    tables = compare_records("tables", one.tables, other.tables)
    return np.array_equal(*values, equal_nan=True) and not tables.reason and tables.difference == 0


def counted(calls: list[int]):
    def observer(config: CampaignConfig, link: Link, scene: Scene, truth: Truth) -> BeamSweep:
        calls.append(truth.stop)
        return observe(config, link, scene, truth)

    return observer


def test_a_directory_gives_the_same_results_as_memory_and_is_used_again(
    loaded: Campaign, in_memory: CampaignRun, scores: Scores, tmp_path: Path
) -> None:
    config = loaded.config
    store = CampaignStore(tmp_path / "out", config, loaded.source.text)
    store.open_for_writing()
    calls: list[int] = []
    kept = replace(in_memory, results=store, observer=counted(calls))
    assert same(kept.scores(), scores)
    assert calls == list(STOPS)
    (store.directory / "channel" / "stop_001.nc").unlink()
    (store.directory / "map" / "slam.nc").unlink()
    assert same(replace(kept).scores(), scores)
    assert calls == [*STOPS, 1]


def test_a_run_in_memory_has_the_attributes_of_one_in_a_directory(
    in_memory: CampaignRun, scores: Scores, loaded: Campaign, tmp_path: Path
) -> None:
    run, fresh = MemoryRun(in_memory), loaded.run(STOPS)
    assert isinstance(fresh, MemoryRun) and issubclass(ia.FinishedRun, RunResults)
    assert same(run.scores, scores) and [truth.stop for truth in run.truths] == list(STOPS)
    assert len(run.channel) == len(STOPS) and run.slam is run.results.slam and run.mapping is run.results.mapping
    memory, files = ({name for name in dir(kind) if name[0] != "_"} for kind in (MemoryRun, ia.FinishedRun))
    assert memory == files and {"plot", "to_dataframe", "scores", "directory", "config"} <= memory
    assert run.plot().has_data() and run.directory is None
    assert (
        run.doubts[: len(run.scores.doubts)] == run.scores.doubts and "hardly check one another" in run.doubts[-1]
    )
    with pytest.raises(TypeError, match=r"MemoryRun is no table; its parts: .*truths, results, scores"):
        run.to_dataframe()
    assert repr(run).startswith("MemoryRun('small' in memory, ")
    assert re.search(r"Receiver position in plan by SLAM, RMSE \d", repr(run)) and len(repr(run)) < 400
    assert repr(fresh) == f"MemoryRun('small' in memory, {len(STOPS)} stops: no scores yet)"
    assert len(repr(in_memory)) < 100
    with pytest.raises(ValueError, match="leave out either stops or out"):
        loaded.run(STOPS, out=tmp_path)


def test_some_of_the_stops_give_the_same_bits(in_memory: CampaignRun) -> None:
    whole = {estimate.stop: estimate for estimate in in_memory.channel(in_memory.truths())}
    some = replace(in_memory, results=MemoryResults(), stops=(3, 1))
    truths = list(some.truths())
    assert [truth.stop for truth in truths] == [3, 1]
    for truth, estimate in zip(truths, some.channel(truths), strict=True):
        assert compare_records("truth", in_memory.results.truth(truth.stop), truth).difference == 0
        found = compare_records("channel", whole[truth.stop], estimate)
        assert not found.reason and found.difference == 0


def test_given_paths_replace_traced_ones_and_get_the_clock_of_the_settings(in_memory: CampaignRun) -> None:
    traced = list(in_memory.truths())
    other_clock = in_memory.config.model_copy(update={"seed": in_memory.config.seed + 1})
    given = CampaignRun(other_clock, in_memory.scene, paths=[replace(traced[2], clock_bias_s=1.0)])
    (truth,) = given.truths()
    assert truth.stop == STOPS[2] and truth.paths is traced[2].paths
    alone = CampaignRun(other_clock, in_memory.scene, stops=STOPS[2:3])
    assert truth.clock_bias_s == next(alone.truths()).clock_bias_s != traced[2].clock_bias_s


def test_a_users_estimator_replaces_that_of_the_settings(
    in_memory: CampaignRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "strongest_paths.py").write_text(MODULE)
    own = with_functions(in_memory.config, {"channel": "strongest_paths:strongest"})
    run = replace(in_memory, config=own, results=MemoryResults())
    assert all(len(estimate) <= 3 for estimate in run.channel(in_memory.truths()))
    assert any(len(estimate) > 3 for estimate in in_memory.channel(in_memory.truths()))


def test_another_observer_and_true_poses_replace_their_stages(in_memory: CampaignRun) -> None:
    def silent(config: CampaignConfig, link: Link, scene: Scene, truth: Truth) -> BeamSweep:
        sweep = observe(config, link, scene, truth)
        return replace(sweep, samples=np.zeros_like(sweep.samples))

    deaf = replace(in_memory, results=MemoryResults(), observer=silent)
    assert all(not len(estimate) for estimate in deaf.channel(in_memory.truths()))
    truths = list(in_memory.truths())
    channel = list(in_memory.channel(truths))
    maps = replace(in_memory, results=MemoryResults()).maps(channel, known_receiver(truths))
    true_m = np.array([truth.rx_pose.position_m[:2] for truth in truths])
    np.testing.assert_array_equal(maps["mapping"].poses.position_m, true_m)
    assert (maps["mapping"].poses.status == SolveStatus.GIVEN).all()
    assert (maps["slam"].poses.status != SolveStatus.GIVEN).all()


@pytest.fixture
def calibrated(in_memory: CampaignRun) -> Iterator[tuple[CampaignRun, list[int]]]:
    settings = ChannelConfig(
        method="incoherent", self_calibration=SelfCalibrationConfig(use="always", stops=2, min_snr_db=10, turns=2)
    )
    impairments = ImpairmentsConfig(element_gain_std_db=1.0, element_phase_std_deg=10.0)
    config = in_memory.config.model_copy(update={"channel": settings, "impairments": impairments})
    calls: list[int] = []
    yield replace(in_memory, config=config, results=MemoryResults(), observer=counted(calls)), calls


def test_self_calibration_takes_stops_spread_over_the_run_and_is_made_once(
    calibrated: tuple[CampaignRun, list[int]],
) -> None:
    run, calls = calibrated
    made = run.calibrate()
    assert made is not None and calls == [STOPS[0], STOPS[-1]]
    assert run.calibrate() is made
    own = with_functions(run.config, {"channel": "any:thing"})
    assert replace(run, config=own, results=MemoryResults()).calibrate() is None
    assert calls == [STOPS[0], STOPS[-1]]


def test_self_calibration_is_named_only_where_there_may_be_one() -> None:
    """The power method, the paper's, has designed arrays unless a calibration is asked for."""
    for method, use, calibrates in (
        ("auto", "auto", True),
        ("auto", "never", False),
        ("power", "auto", False),
        ("power", "always", True),
    ):
        settings = {"channel.method": method, "channel.self_calibration.use": use}
        asked = ia.load_campaign("box_room", **settings)
        assert asked.chain().calibrates == calibrates
        own = with_functions(asked.config, {"channel": "mine:guess"})
        assert not CampaignRun(own, asked.scene).calibrates
