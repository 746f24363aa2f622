"""The memory that a process of a user's function may take."""

import sys

from scenes.memory import memory_limit_bytes


def share_bytes() -> float:
    """The limit in force; in a worker of dask the size at which dask would end that worker."""
    limit = memory_limit_bytes()
    if "distributed.worker" not in sys.modules:
        return limit
    import dask  # noqa: PLC0415  (takes a second)
    from distributed import get_worker  # noqa: PLC0415

    try:
        held = get_worker().memory_manager.memory_limit
    except ValueError:  # this process is no worker
        return limit
    share = dask.config.get("distributed.worker.memory.terminate")
    return min(limit, held * float(share)) if held and share else limit
