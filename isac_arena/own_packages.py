"""Where the packages of this project come from: a user's own folder of the same name must not take their place."""

from importlib.util import find_spec
from pathlib import Path

OWN_PACKAGES = ("scenes", "sim", "estimation")
ROOT = Path(__file__).resolve().parents[1]  # of the checkout, or of the installed packages


def check_own_packages() -> None:
    """Raise `ImportError`, one line, where Python would import one of our packages from elsewhere."""
    for name in OWN_PACKAGES:
        found = _found(name)
        if found is None:
            raise ImportError(f"{ROOT / name}: is missing; install ISAC Arena again")
        if found.parent != ROOT:
            raise ImportError(
                f"{found}: hides the package '{name}' of ISAC Arena; rename it, or run from another folder and "
                "without it in PYTHONPATH"
            )


def hiding_names(folder: Path) -> list[Path]:
    """Folders and files of `folder` that would hide our packages if Python looked there first."""
    if folder.resolve() == ROOT:
        return []
    pairs = [(folder / name, folder / f"{name}.py") for name in OWN_PACKAGES]
    return [path for pair in pairs for path in pair if (path / "__init__.py").is_file() or path.is_file()]


def _found(name: str) -> Path | None:
    """The folder of a package, or the file of a module; None where neither exists."""
    try:
        spec = find_spec(name)
    except ValueError:  # it was imported without a spec
        return None
    if spec is None:
        return None
    folders = list(spec.submodule_search_locations or ())
    place = folders[0] if folders else spec.origin
    return None if place is None else Path(place).resolve()
