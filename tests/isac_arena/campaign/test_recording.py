"""The manifest of a directory: entries of what a run wrote, with the hash that it was written with."""

import json
from contextlib import suppress
from pathlib import Path

import pytest

from isac_arena.campaign.files import remove_file, write_record, write_text
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.manifest import check_files, check_unchanged, made_by, read_manifest, write_manifest
from isac_arena.campaign.recording import recorded_additions, recorded_run
from scenes.record import empty_record
from sim.truth import Truth


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with recorded_run(tmp_path):
        write_text(tmp_path / "a.txt", "first")
        write_text(tmp_path / "sub" / "b.txt", "second")
    return tmp_path


def test_a_later_run_keeps_the_hash_of_a_file_that_it_did_not_write(folder: Path) -> None:
    (folder / "a.txt").write_text("worst")
    (folder / "c.txt").write_text("not of a run")
    with recorded_run(folder):
        write_text(folder / "sub" / "b.txt", "third")
        write_text(folder / "d.txt", "fourth")
    found = check_files(folder)
    assert found.changed == ("a.txt",) and found.unknown == ("c.txt",)
    assert found.missing == found.unfinished == ()
    (folder / "a.txt").write_text("first")
    (folder / "c.txt").unlink()
    assert check_files(folder).problems == []


def test_a_hash_is_that_of_the_bytes_that_were_written(tmp_path: Path) -> None:
    with recorded_run(tmp_path):
        write_text(tmp_path / "a.txt", "first")
        (tmp_path / "a.txt").write_text("worst")  # a fault of the disk before the run ends
    assert check_files(tmp_path).changed == ("a.txt",)


def test_files_that_a_run_removes_are_not_missed_but_others_are(folder: Path) -> None:
    (folder / "sub" / "b.txt").unlink()
    with recorded_run(folder):
        remove_file(folder / "a.txt")
    assert check_files(folder).missing == ("sub/b.txt",)


def test_a_killed_run_leaves_no_wrong_entry_and_the_next_one_takes_its_records(folder: Path) -> None:
    with suppress(RuntimeError), recorded_run(folder):
        write_text(folder / "a.txt", "half")
        write_record(folder / "truth" / "stop_000.nc", empty_record(Truth))
        raise RuntimeError("killed")
    found = check_files(folder)
    assert found.changed == () and found.unfinished == ("manifest.json",)
    assert found.unknown == ("a.txt", "truth/stop_000.nc")
    (folder / "truth" / "stop_001.nc").write_bytes((folder / "truth" / "stop_000.nc").read_bytes()[:-1])
    with recorded_run(folder):
        pass
    found = check_files(folder)
    assert found.unfinished == () and found.unknown == ("a.txt", "truth/stop_001.nc")


def test_additions_need_a_manifest_and_leave_it_to_a_run_at_work(folder: Path, tmp_path: Path) -> None:
    with one_run(folder), recorded_additions(folder):
        write_text(folder / "view.html", "page")
    assert check_files(folder).unknown == ("view.html",)
    with recorded_additions(folder):
        write_text(folder / "view.html", "page")
        write_text(tmp_path.parent / "other.html", "page")
    assert check_files(folder).unknown == () and "view.html" in read_manifest(folder).files
    bare = tmp_path.parent / "bare"
    with recorded_additions(bare):
        write_text(bare / "view.html", "page")
    assert [path.name for path in bare.iterdir()] == ["view.html"]


def test_a_directory_with_a_manifest_inside_is_a_unit(folder: Path) -> None:
    unit = folder / "cases" / "one"
    with recorded_run(unit):
        write_text(unit / "scores.json", "[]")
    with recorded_run(folder):
        pass
    assert {"a.txt", "sub/b.txt", "cases/one/manifest.json"} == set(read_manifest(folder).files)
    assert check_files(folder).n_files == 4
    (unit / "scores.json").write_text("[1]")
    assert check_files(folder).changed == ("cases/one/scores.json",)
    with pytest.raises(
        ValueError, match=r"scores.json: damaged or edited since it was written; remove it and run"
    ):
        check_unchanged(unit, ["scores.json"])
    check_unchanged(folder, ["sub", "a.txt"])


def test_a_manifest_is_sealed_and_keeps_what_made_each_file(folder: Path) -> None:
    held = read_manifest(folder)
    assert held.made_by == [made_by()]
    held.made_by[0]["code"] = "older"
    write_manifest(folder, held)
    with recorded_run(folder):
        write_text(folder / "c.txt", "third")
    found = read_manifest(folder)
    origins = {name: found.made_by[entry["made_by"]]["code"] for name, entry in found.files.items()}
    assert origins == {"a.txt": "older", "sub/b.txt": "older", "c.txt": made_by()["code"]}
    content = json.loads((folder / "manifest.json").read_text())
    content["files"]["a.txt"]["bytes"] += 1
    (folder / "manifest.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"manifest.json: damaged or edited since it was written"):
        read_manifest(folder)
