"""The rules of the house: who imports whom, how long a file may be, and that packages neither print nor exit."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("scenes", "sim", "estimation", "isac_arena")
MAX_FILE_LINES = 350
MAX_FUNCTION_LINES = 70
MAX_FILES_OF_FOLDER = 20

ENDING_CALLS = {"print", "exit", "quit", "sys.exit", "os._exit", "os.abort"}
OUTPUT_STREAMS = {"sys.stdout", "sys.stderr"}
FILE_CALLS = {"open", "read_text", "read_bytes", "write_text", "write_bytes"}
ENDING_FILE = "isac_arena/cli/main.py"  # the one file that may end the process, after one line on stderr
# Where files may be read and written: rule 4 of the house.
FILE_PARTS = (
    *(
        "isac_arena/campaign/",
        "isac_arena/cli/",
        "isac_arena/datasets/",
        "isac_arena/exchange/",
        "isac_arena/public_tasks/",
        "isac_arena/sweep/",
        "isac_arena/verification/",
        "isac_arena/workers/tasks.py",  # of no content: a process that ends is silent
        "isac_arena/validation/robustness/",
        "isac_arena/validation/exchange/",
    ),
    *("isac_arena/insight/budget/runs.py", "isac_arena/validation/benches/"),
    "estimation/kernel_cache.py",  # reads source code
    "isac_arena/kernels.py",  # the marker beside compiled kernels
    *("scenes/inputs.py", "scenes/memory.py"),
    *("isac_arena/doctor.py", "isac_arena/validation/golden.py"),
    *("isac_arena/report/page/template.py", "isac_arena/report/page/budget_file.py"),
    *(
        "scenes/config.py",
        "scenes/inputs.py",
        "scenes/memory.py",
        "scenes/toml_config.py",
        "scenes/objects/config.py",
        "scenes/motion/config.py",
        "scenes/walks/config.py",
    ),
    *("scenes/meshes/", "sim/signal/arrays/weights_file.py", "sim/propagation/deepmimo/"),
)

# One line appended to one file, and the contract that has to notice it.
VIOLATIONS = [
    ("scenes/pose.py", "import sim.signal.arrays.array", "packages"),
    ("estimation/slam/record.py", "import estimation.shape.record", "estimation"),
    ("estimation/channel/record.py", "import estimation.slam.record", "estimation"),
    ("estimation/shape/record.py", "import estimation.channel.power.paths", "channel-beside"),
    ("estimation/channel/record.py", "import sim.propagation.paths", "wall-sim"),
    ("estimation/slam/record.py", "import scenes.scene", "wall-scenes"),
    ("sim/observation.py", "import sim.truth", "observation"),
    ("sim/signal/arrays/array.py", "def f():\n    import drjit", "tracer"),
    ("sim/propagation/paths.py", "import trimesh", "mesh"),
    ("isac_arena/cli/__init__.py", "import matplotlib.pyplot", "figures"),
    ("estimation/shape/record.py", "import xarray", "files"),
]


def python_files(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def lint_imports(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command as run; run()",
            *("--no-cache", "--no-logo", *arguments),
        ],
        cwd=root,
        env={"PYTHONPATH": str(root), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("copy")
    shutil.copy(ROOT / "pyproject.toml", root)
    for package in PACKAGES:
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    return root


def test_import_contracts_hold() -> None:
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(("file", "line", "contract"), VIOLATIONS)
def test_import_contract_notices(copy: Path, file: str, line: str, contract: str) -> None:
    original = (copy / file).read_text(encoding="utf-8")
    (copy / file).write_text(f"{original}\n{line}\n", encoding="utf-8")
    result = lint_imports(copy, "--contract", contract)
    (copy / file).write_text(original, encoding="utf-8")
    assert result.returncode == 1, result.stdout + result.stderr
    assert "1 broken" in result.stdout, result.stdout + result.stderr


@pytest.mark.parametrize("path", python_files(*PACKAGES, "tests"), ids=relative)
def test_files_and_functions_are_short(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MAX_FILE_LINES
    long = [
        f"{node.name} ({node.end_lineno - node.lineno + 1} lines)"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.end_lineno is not None
        and node.end_lineno - node.lineno >= MAX_FUNCTION_LINES
    ]
    assert not long, f"functions over {MAX_FUNCTION_LINES} lines: {long}"


@pytest.mark.parametrize("path", python_files(*PACKAGES), ids=relative)
def test_packages_neither_print_nor_exit_nor_touch_files(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            call = ast.unparse(node.func)
            found += [call] if call in ENDING_CALLS else []
            is_file_module = str(path.relative_to(ROOT)).startswith(FILE_PARTS)
            if not is_file_module and call.rpartition(".")[2] in FILE_CALLS:
                found.append(call)
        elif isinstance(node, ast.Attribute) and ast.unparse(node) in OUTPUT_STREAMS:
            found.append(ast.unparse(node))
        elif isinstance(node, ast.Name) and node.id == "SystemExit":
            found.append("SystemExit")
    if str(path.relative_to(ROOT)) == ENDING_FILE:
        assert set(found) <= {"sys.exit", "sys.stderr"}
        return
    assert not found, f"{path.relative_to(ROOT)}: {', '.join(found)}"


def test_no_folder_is_crowded() -> None:
    files = Counter(path.parent.relative_to(ROOT) for path in python_files(*PACKAGES, "tests"))
    assert not [str(folder) for folder, count in files.items() if count > MAX_FILES_OF_FOLDER]


def test_a_folder_is_no_prefix_of_file_names() -> None:
    folders = {path.parent for path in python_files(*PACKAGES)}
    named = [
        path.relative_to(ROOT)
        for path in python_files(*PACKAGES)
        for folder in folders
        if folder.parent == path.parent and path.stem.startswith(f"{folder.name}_")
    ]
    assert not named


def test_a_class_name_is_used_once() -> None:
    places = defaultdict(list)
    for path in python_files(*PACKAGES):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in places.items() if len(paths) > 1} == {}


@pytest.mark.parametrize("package", sorted({path.parent for path in python_files(*PACKAGES)}), ids=relative)
def test_a_package_says_what_to_read_first(package: Path) -> None:
    """Every file and folder that the docstring of a package names is there."""
    docstring = ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8"))) or ""
    named = re.findall(r"`([\w./]+(?:\.py|/))`", docstring)
    assert named or len(docstring.splitlines()) == 1
    assert not [name for name in named if not (package / name).exists()]
