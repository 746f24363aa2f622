"""The public names of `isac_arena`: they exist, they come late, and no folder of a user takes their place."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import isac_arena

ROOT = Path(__file__).resolve().parents[2]
ARENA = "from isac_arena.cli.main import main; main()"
HEAVY = ("numpy", "scipy", "numba", "sklearn", "matplotlib", "plotly", "pydantic", "rich", "typer", "sionna")


def python(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python as a user does who has installed the package."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env={"PATH": "/usr/bin:/bin", **environment},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(params=["package", "module"])
def hiding_folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """What takes the place of our `sim` where Python looks into `tmp_path` first."""
    if request.param == "module":
        (tmp_path / "sim.py").write_text("theirs = True\n", encoding="utf-8")
        return tmp_path / "sim.py"
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim" / "__init__.py").write_text("theirs = True\n", encoding="utf-8")
    return tmp_path / "sim"


@pytest.mark.parametrize("name", isac_arena.__all__)
def test_every_public_name_exists(name: str) -> None:
    assert getattr(isac_arena, name) is getattr(isac_arena, name)


def test_names_for_type_checkers_and_at_run_time_are_the_same() -> None:
    tree = ast.parse((ROOT / "isac_arena" / "__init__.pyi").read_text(encoding="utf-8"))
    typed = {(node.module, a.name) for node in tree.body if isinstance(node, ast.ImportFrom) for a in node.names}
    modules = {("isac_arena", name) for name in isac_arena.MODULES}
    assert typed == modules | {(module, name) for module, names in isac_arena.HOMES.items() for name in names}
    names = [*isac_arena.MODULES, *(name for names in isac_arena.HOMES.values() for name in names)]
    assert sorted([*names, "__version__"]) == sorted(isac_arena.__all__)
    assert set(isac_arena.__all__) <= set(dir(isac_arena))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'no_such_name'"):
        _ = isac_arena.no_such_name


def test_the_version_of_a_checkout_that_is_not_installed_is_that_of_its_project_file(tmp_path: Path) -> None:
    code = (
        "from importlib import metadata\n"
        "def version(name): raise metadata.PackageNotFoundError(name)\n"
        "metadata.version = version\n"
        "import isac_arena; print(isac_arena.__version__)"
    )
    result = python("-c", code, cwd=tmp_path)
    assert f'version = "{result.stdout.strip()}"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_the_import_brings_nothing_heavy(tmp_path: Path) -> None:
    code = f"import sys, isac_arena; print([name for name in {HEAVY} if name in sys.modules])"
    assert python("-c", code, cwd=tmp_path).stdout.strip() == "[]"


def test_the_help_brings_no_library_of_numbers(tmp_path: Path) -> None:
    code = "import sys, isac_arena.cli.main; print([name for name in sys.argv[1:] if name in sys.modules])"
    heavy = [name for name in HEAVY if name not in ("rich", "typer")]
    assert python("-c", code, *heavy, cwd=tmp_path).stdout.strip() == "[]"


def test_the_command_runs_as_a_module_from_any_folder(tmp_path: Path) -> None:
    result = python("-m", "isac_arena", "scene", "list", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "box_room" in result.stdout


def test_a_package_of_the_user_in_the_way_is_named_in_one_line(hiding_folder: Path) -> None:
    code = "import isac_arena"
    result = python("-c", code, cwd=hiding_folder.parent)
    assert result.returncode == 1
    line = result.stderr.strip().splitlines()[-1]
    assert line.startswith(f"ImportError: {hiding_folder}: hides the package 'sim' of ISAC Arena; rename it")


def test_the_module_as_a_command_names_it_too(hiding_folder: Path) -> None:
    result = python("-m", "isac_arena", "scene", "list", cwd=hiding_folder.parent)
    assert result.returncode == 1
    assert f"{hiding_folder}: hides the package 'sim'" in result.stderr.strip().splitlines()[-1]


def test_a_folder_that_is_no_package_is_not_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "sim").mkdir()
    result = python("-c", "import isac_arena, sim.observation; print(sim.__file__)", cwd=tmp_path)
    assert result.stdout.strip() == str(ROOT / "sim" / "__init__.py"), result.stderr


def arena_script(folder: Path) -> Path:
    """The `arena` command as an installer writes it: a script that stands in another folder."""
    script = folder / "bin" / "arena"
    script.parent.mkdir()
    script.write_text(ARENA, encoding="utf-8")
    return script


def test_the_script_uses_our_packages_and_says_so(
    hiding_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    script = arena_script(tmp_path_factory.mktemp("installed"))
    result = python(str(script), "scene", "list", cwd=hiding_folder.parent)
    assert result.returncode == 0, result.stderr
    assert "box_room" in result.stdout
    assert result.stderr == (f"arena: {hiding_folder}: has the name of a package of ISAC Arena and is not used\n")


def test_the_script_finds_an_estimator_beside_a_hiding_folder(
    hiding_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (hiding_folder.parent / "my_lab.py").write_text("import sim.observation\nhere = sim\n", encoding="utf-8")
    installed = tmp_path_factory.mktemp("installed")
    script = arena_script(installed)
    script.write_text(
        "import isac_arena.cli.main as main; main._add_working_folder()\n"
        "import my_lab; print(my_lab.here.__file__)\n",
        encoding="utf-8",
    )
    result = python(str(script), cwd=hiding_folder.parent)
    assert result.stdout.strip() == str(ROOT / "sim" / "__init__.py"), result.stderr
