"""Shards: the same bytes as single files, read one at a time, and nothing lost when files are made again."""

import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from isac_arena.campaign import shards
from isac_arena.campaign.directory import open_campaign
from isac_arena.campaign.files import read_attribute, read_record, write_record
from isac_arena.campaign.shards import Member, blocks, is_whole_shard, places, shard_name, stop_name, write_shard
from isac_arena.campaign.stored import pack_stops
from scenes.record import empty_record
from sim.truth import Truth
from tests.command_line import arena_here, failure
from tests.isac_arena.cli.sweep_files import write_sweep

LAB = """
from estimation.channel.record import empty_estimate

def nothing(sweep):
    if sweep.stop == 2:
        raise ValueError("no idea")
    return empty_estimate(sweep.stop, "none", "no paths", "")
"""


@pytest.fixture
def shard(tmp_path: Path) -> Path:
    """A shard of two files, which are there as well."""
    files = []
    for stop in (0, 1):
        write_record(tmp_path / stop_name(stop), empty_record(Truth), {"title": f"number {stop}"})
        files.append((stop_name(stop), tmp_path / stop_name(stop)))
    write_shard(tmp_path / shard_name(0), files)
    return tmp_path / shard_name(0)


@pytest.fixture
def long_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A campaign of four stops, in shards of three."""
    monkeypatch.setattr(shards, "STOPS_A_SHARD", 3)
    write_sweep(tmp_path)
    (tmp_path / "lab.py").write_text(LAB)
    result = arena_here("run", "small.toml", "--out", "run", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    return tmp_path / "run"


def names(run: Path, kind: str) -> list[str]:
    return sorted(file.name for file in (run / kind).iterdir())


def test_a_member_has_the_bytes_of_its_file_and_the_same_files_make_the_same_shard(shard: Path) -> None:
    member = Member(shard, "stop_001.nc")
    assert member.is_file() and not Member(shard, "stop_002.nc").is_file()
    assert member.content() == (shard.parent / "stop_001.nc").read_bytes()
    assert read_attribute(member, "title") == "number 1"
    assert len(read_record(member, Truth).paths.delay_s) == 0
    again = shard.with_name("again.zip")
    write_shard(again, [(name, shard.parent / name) for name in ("stop_000.nc", "stop_001.nc")])
    assert again.read_bytes() == shard.read_bytes()


@given(st.integers(0, 20_000), st.sampled_from(["", "_north_east"]))
def test_every_stop_has_one_place_in_the_shards(stop: int, tx: str) -> None:
    single, member = places(Path("truth") / stop_name(stop, tx))
    assert single == Path("truth") / stop_name(stop, tx) and isinstance(member, Member)
    assert member == Member(Path("truth") / shard_name(stop, tx), stop_name(stop, tx))
    [block] = [block for block in blocks(20_001) if stop in block]
    assert shard_name(block[0], tx) == shard_name(stop, tx)


def test_only_long_campaigns_have_shards() -> None:
    assert blocks(shards.STOPS_A_SHARD) == []
    assert [len(block) for block in blocks(shards.STOPS_A_SHARD + 1)] == [shards.STOPS_A_SHARD, 1]
    assert list(places(Path("map/slam.nc"))) == [Path("map/slam.nc")]


def test_a_shard_that_is_no_archive_or_has_packed_members_is_refused_in_one_line(shard: Path) -> None:
    whole = shard.read_bytes()
    with zipfile.ZipFile(shard, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("stop_000.nc", bytes(10**6))
    with pytest.raises(ValueError, match=r"stops_000-255\.zip: stop_000\.nc is compressed"):
        Member(shard, "stop_000.nc").content()
    shard.write_bytes(whole[: len(whole) // 2])
    assert not is_whole_shard(shard)
    with pytest.raises(ValueError, match=r"stops_000-255\.zip: damaged .*; remove it"):
        Member(shard, "stop_000.nc").is_file()


def test_a_changed_member_is_no_record(shard: Path) -> None:
    content = bytearray(shard.read_bytes())
    content[200] ^= 1
    shard.write_bytes(content)
    assert not is_whole_shard(shard)
    assert read_attribute(Member(shard, "stop_000.nc"), "title") is None
    assert read_attribute(Member(shard, "stop_001.nc"), "title") == "number 1"


def test_a_long_campaign_has_the_results_of_single_files(long_run: Path, finished: Path) -> None:
    for kind in ("truth", "channel"):
        assert names(long_run, kind) == ["stops_000-002.zip", "stops_003-005.zip"]
    single = finished / "run"
    assert (long_run / "scores.json").read_bytes() == (single / "scores.json").read_bytes()
    for stop in (0, 3):
        member = Member(long_run / "truth" / shard_name(stop), stop_name(stop))
        assert member.content() == (single / "truth" / stop_name(stop)).read_bytes()
    assert arena_here("verify", long_run).returncode == 0


def test_a_lost_shard_is_made_again_and_a_damaged_one_is_named(long_run: Path) -> None:
    shard = long_run / "channel" / "stops_000-002.zip"
    before = shard.read_bytes()
    shard.write_bytes(before[:-1] + bytes([before[-1] ^ 1]))
    line = failure("run", "small.toml", "--out", "run", cwd=long_run.parent)
    assert "channel/stops_000-002.zip: damaged or edited" in line and "remove it and run 'arena estimate'" in line
    shard.unlink()
    assert arena_here("run", "small.toml", "--out", "run", cwd=long_run.parent).returncode == 0
    assert shard.read_bytes() == before and names(long_run, "channel") == [
        "stops_000-002.zip",
        "stops_003-005.zip",
    ]


def test_estimates_made_again_take_the_place_of_members(long_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(long_run.parent))  # where the function is
    result = arena_here("estimate", "run", "--estimator", "lab:nothing", cwd=long_run.parent)
    assert result.returncode == 1, result
    store = open_campaign(long_run)
    found = [store.channel(stop) for stop in range(4)]
    assert [None if one is None else one.channel.method for one in found] == ["none", "none", "function", "none"]
    assert names(long_run, "channel") == ["stops_000-002.zip", "stops_003-005.zip"]
    (long_run / "channel" / stop_name(1)).write_bytes(
        Member(long_run / "channel" / shard_name(1), stop_name(1)).content()
    )
    pack_stops(store)
    assert names(long_run, "channel") == ["stops_000-002.zip", "stops_003-005.zip"]
