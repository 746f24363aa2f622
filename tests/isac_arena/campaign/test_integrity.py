"""Fingerprints of source code: they change with every name and content, and name a part that is missing."""

from pathlib import Path

import pytest

from isac_arena.campaign.integrity import code_digest, source_digest


@pytest.mark.parametrize("part", ["estimation/no_such_folder", "estimation/no_such_file.py"])
def test_a_part_that_does_not_exist_is_named(part: str) -> None:
    with pytest.raises(ValueError, match=f"{part}: no such file or folder"):
        code_digest("estimation/channel", part)


def test_a_folder_without_python_files_is_named() -> None:
    with pytest.raises(ValueError, match="tests/golden: a folder without Python files"):
        code_digest("tests/golden")


def test_the_digest_depends_on_names_and_contents(tmp_path: Path) -> None:
    for name in ("as_is", "renamed", "changed"):
        (tmp_path / name / "package").mkdir(parents=True)
        (tmp_path / name / "package" / "one.py").write_text("x = 1\n")
    before = source_digest(tmp_path / "as_is", "package")
    assert source_digest(tmp_path / "changed", "package") == before
    (tmp_path / "changed" / "package" / "one.py").write_text("x = 2\n")
    (tmp_path / "renamed" / "package" / "one.py").rename(tmp_path / "renamed" / "package" / "two.py")
    digests = {source_digest(tmp_path / name, "package") for name in ("as_is", "renamed", "changed")}
    assert len(digests) == 3
    assert source_digest(tmp_path / "as_is", "package/one.py") == before
