"""Time-domain samples to SigMF recordings (version 1.0.0) and back: NAME.sigmf-meta and NAME.sigmf-data."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from isac_arena.campaign.files import complete_file, write_json
from scenes.record import ComplexArray

DATATYPE = "cf32_le"


def write_sigmf(
    base: Path,
    bursts: Sequence[ComplexArray],
    labels: Sequence[str],
    *,
    sample_rate_hz: float,
    carrier_hz: float,
    description: str,
) -> Path:
    """Write bursts of samples, one after the other with an annotation each; returns the path of the metadata.

    Bursts are not contiguous in time, so each starts a capture segment of its own. Samples are stored as
    complex64, little-endian. The metadata is written last: a recording with metadata is complete.
    """
    samples = np.concatenate(bursts).astype("<c8")
    start = np.concatenate([[0], np.cumsum([len(burst) for burst in bursts])]).tolist()
    metadata = {
        "global": {
            "core:datatype": DATATYPE,
            "core:sample_rate": sample_rate_hz,
            "core:version": "1.0.0",
            "core:sha512": hashlib.sha512(samples.tobytes()).hexdigest(),
            "core:description": description,
            "core:recorder": "isac-arena",
        },
        "captures": [{"core:sample_start": first, "core:frequency": carrier_hz} for first in start[:-1]],
        "annotations": [
            {"core:sample_start": first, "core:sample_count": len(burst), "core:label": label}
            for first, burst, label in zip(start[:-1], bursts, labels, strict=True)
        ],
    }
    data, meta = (base.with_name(f"{base.name}.sigmf-{kind}") for kind in ("data", "meta"))
    with complete_file(data) as partial:
        samples.tofile(partial)
    write_json(meta, metadata)
    return meta


def read_sigmf(base: Path) -> tuple[ComplexArray, dict[str, Any]]:
    """Samples (sample,) and metadata of a recording written by `write_sigmf`.

    Raises `FileNotFoundError` where a file is missing; `ValueError` where the metadata is damaged or names
    another datatype, or the samples are not those it was written with.
    """
    data, meta = (base.with_name(f"{base.name}.sigmf-{kind}") for kind in ("data", "meta"))
    try:
        metadata = json.loads(meta.read_text(encoding="utf-8"))
        datatype, checksum = (metadata["global"][f"core:{key}"] for key in ("datatype", "sha512"))
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{meta}: not readable SigMF metadata ({error})") from error
    if datatype != DATATYPE:
        raise ValueError(f"{meta}: core:datatype = {datatype}: must be {DATATYPE}")
    content = data.read_bytes()
    if hashlib.sha512(content).hexdigest() != checksum:
        raise ValueError(f"{data}: differs from the core:sha512 of its metadata")
    return np.frombuffer(content, "<c8"), metadata
