"""Names that may become part of a path, and how they are joined to a folder."""

import os
import re
from pathlib import Path, PurePosixPath
from typing import Annotated

from pydantic import AfterValidator

LONGEST_NAME = 120  # bytes: file systems take 255, and names get endings
NAME = re.compile(r"\w[\w .+()-]*")
LONGEST_PATH = 4000
ALLOWED = f"letters, digits and _ . + - ( ) or blanks, a letter or digit first, at most {LONGEST_NAME} bytes"


def checked_name(name: str) -> str:
    """The name; `ValueError` where it could not be part of a path."""
    if not NAME.fullmatch(name) or len(name.encode("utf-8", "surrogatepass")) > LONGEST_NAME:
        raise ValueError(f"a name has {ALLOWED}")
    return name


# Of campaigns, sweeps, scenes, objects, TXs and walks: it may become the name of a file and leads nowhere else
Name = Annotated[str, AfterValidator(checked_name)]


def _checked_file(name: str) -> str:
    if not name or "\0" in name or len(name) > LONGEST_PATH:
        raise ValueError(f"a file name has 1 to {LONGEST_PATH} characters, and no NUL")
    return name


FileName = Annotated[str, AfterValidator(_checked_file)]  # of an input: it may be in any folder


def name_from(text: str) -> str:
    """A valid name made from any text, such as the name of a file: other characters become `_`."""
    name = re.sub(r"[^\w .+()-]", "_", text)
    name = name.encode("utf-8", "replace")[:LONGEST_NAME].decode("utf-8", "ignore")
    return name if NAME.fullmatch(name) else f"x{name[:-1]}"


def path_in(folder: Path, name: str) -> Path:
    """The path of a name in a folder, or in folders below it.

    Raises `ValueError` where the name is empty, absolute, holds a NUL or `..`, and so could lead elsewhere.
    """
    if not PurePosixPath(name).parts or name.startswith("/") or "\0" in name or ".." in name.split("/"):
        raise ValueError(f"name = {name[:80]!r}: leads out of {folder}; a name below this folder is needed")
    return folder / name


def refuse_outer_links(folder: Path) -> None:
    """Raise `ValueError` where a link below a folder leads out of it: a stranger's link may name any file."""
    root = os.path.realpath(folder)
    for here, folders, files in os.walk(root):
        for name in (*folders, *files):
            path = os.path.join(here, name)
            if os.path.islink(path) and not os.path.realpath(path).startswith(f"{root}{os.sep}"):
                raise ValueError(f"{path}: a link that leads out of {folder}; put the file itself there")
