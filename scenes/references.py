"""Files that a scene file refers to, and the names of their copies beside a copied scene file."""

from pathlib import Path
from urllib.parse import quote

KEPT_FOLDER = "scene_files"  # folder beside a copied scene file with copies of the files it refers to


def copy_name(file: str) -> str:
    """Path, relative to a copied scene file, of the copy of a file that the scene file refers to."""
    return f"{KEPT_FOLDER}/{quote(str(Path(file)), safe='')}"


def find_file(folder: Path, file: str) -> Path:
    """Path of a file that a scene file in `folder` refers to: the copy if it exists, else the file."""
    copy = folder / copy_name(file)
    return copy if copy.is_file() else folder / file
