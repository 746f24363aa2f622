"""When a compiled kernel on disk is out of date: after a change in any file that its code comes from.

Numba compares the file of the function only. A kernel that calls a kernel of another file, or takes a constant
from it, would keep the old code after that file changes. Here the name of a kernel on disk holds a digest of its
file and of all files of ours that this one imports, directly and through others. So old kernels are never read.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path

import numba
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

OWN_PACKAGES = frozenset({"scenes", "sim", "estimation"})
_IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


@contextmanager
def named_by_imports() -> Iterator[None]:
    """Context in which numba names kernels on disk by `source_digest`; it leaves a user's own choice alone."""
    before = numba.config.CACHE_LOCATOR_CLASSES
    numba.config.CACHE_LOCATOR_CLASSES = before or ",".join(
        f"{__name__}.{locator.__name__}" for locator in (ProvidedFolder, SourceFolder, UserFolder)
    )
    try:
        yield
    finally:
        numba.config.CACHE_LOCATOR_CLASSES = before


def source_digest(path: Path) -> str:
    """Digest of a Python file and of the files of our packages that it imports, directly and through others."""
    root = path.parent
    while (root / "__init__.py").exists():
        root = root.parent
    names = OWN_PACKAGES | {path.relative_to(root).parts[0]}
    found, to_read = {path}, [path]
    while to_read:
        new = _imported_files(to_read.pop(), root, names) - found
        found |= new
        to_read.extend(new)
    return sha256("".join(_digest(file) for file in sorted(found)).encode()).hexdigest()


class _NamedByImports:
    _py_file: str
    _lineno: int

    def get_disambiguator(self) -> str:
        return f"{self._lineno}-{source_digest(Path(self._py_file).resolve())[:16]}"


class ProvidedFolder(_NamedByImports, UserProvidedCacheLocator):  # type: ignore[misc]
    """Kernels in the folder that NUMBA_CACHE_DIR names."""


class SourceFolder(_NamedByImports, InTreeCacheLocator):  # type: ignore[misc]
    """Kernels beside their source."""


class UserFolder(_NamedByImports, UserWideCacheLocator):  # type: ignore[misc]
    """Kernels in the user's cache, where the source is in a folder that cannot be written."""


@cache
def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


@cache
def _imported_files(path: Path, root: Path, names: frozenset[str]) -> frozenset[Path]:
    files = set()
    for module, imported in _IMPORT.findall(path.read_text(encoding="utf-8")):
        if module.partition(".")[0] not in names:
            continue
        base = root.joinpath(*module.split("."))
        places = [base, *(base / name for name in re.findall(r"\w+", imported))]
        files |= {p for place in places for p in (place.with_suffix(".py"), place / "__init__.py") if p.is_file()}
    return frozenset(files)
