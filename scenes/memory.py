"""Memory is asked for before it is taken: what would not fit is refused in one line, before anything is made."""

import math
import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

ALWAYS_FREE = 1e6  # bytes for which the system is not asked
FREE_SHARE = 0.8  # of the free memory that a command takes by default
UNITS = {"": 1, "B": 1, "KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12, "MIB": 2**20, "GIB": 2**30}
CONTROL_GROUPS = (  # limit and use of a container, in both versions of the kernel's interface
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)

_LIMIT: ContextVar[float | None] = ContextVar("memory_limit", default=None)


class MemoryLimitError(ValueError):
    """A command would take more memory than it may."""


@contextmanager
def limited_memory(limit: str | None) -> Iterator[None]:
    """Limit what is asked for in the block to an amount such as `4GB`; without one to a share of what is free.

    Raises `ValueError` where the amount cannot be read.
    """
    token = _LIMIT.set(None if limit is None else _parsed(limit))
    try:
        yield
    finally:
        _LIMIT.reset(token)


def ask_memory(needed_bytes: float, what: str, change: str) -> None:
    """Raise `MemoryLimitError` where so much memory for `what` is over the limit; `change` names the field."""
    if needed_bytes > ALWAYS_FREE and needed_bytes > (limit := memory_limit_bytes()):
        raise MemoryLimitError(
            f"{change}: {what} would take {_shown(needed_bytes)}, the limit is {_shown(limit)} (--memory)"
        )


def memory_limit_bytes() -> float:
    """The limit in force."""
    limit = _LIMIT.get()
    return FREE_SHARE * free_bytes() if limit is None else limit


def free_bytes() -> float:
    """Memory that this process can still take: of the machine, and of its container where it is in one."""
    free = [math.inf]  # where the system does not say
    try:
        found = re.search(r"^MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(), re.MULTILINE)
        free += [1024.0 * int(found[1])] if found else []
    except OSError:
        pass
    for most, used in CONTROL_GROUPS:
        try:
            free.append(float(Path(most).read_text()) - float(Path(used).read_text()))
        except (OSError, ValueError):  # another version, or `max`: no limit
            continue
    return max(min(free), 0.0)


@contextmanager
def address_space(what: str) -> Iterator[None]:
    """Let a library take no more than the limit in the block: a header can claim any size.

    Raises `MemoryLimitError` where it tries to.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    try:
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except OSError:
        taken = 0
    most = int(min(taken + memory_limit_bytes(), 2**62))
    ends = [end for end in (soft, hard, most) if end != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(ends), hard))
    try:
        yield
    except MemoryError as error:
        limit = _shown(memory_limit_bytes())
        raise MemoryLimitError(f"{what}: would take more than the limit of {limit} (--memory)") from error
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _parsed(text: str) -> float:
    number = text.strip().rstrip("BKMGTIbkmgti")
    unit = text.strip()[len(number) :].upper()
    try:
        value = float(number) * UNITS[unit]
    except (ValueError, KeyError):
        value = -1.0
    if not 0 < value < float("inf"):
        raise ValueError(f"--memory = '{text}': write an amount with its unit, such as 500MB or 4GB")
    return value


def _shown(size_bytes: float) -> str:
    scale, unit = (1e9, "GB") if size_bytes >= 1e9 else (1e6, "MB")
    return f"{size_bytes / scale:.3g} {unit}"
