"""Time-domain samples to SigMF recordings (version 1.0.0) and back: NAME.sigmf-meta and NAME.sigmf-data."""

import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from isac_arena.campaign.files import complete_file, write_json
from scenes.inputs import read_input
from scenes.memory import ask_memory
from scenes.record import ComplexArray

DATATYPE = "cf32_le"
READ_PER_BYTE = 8  # memory while samples are converted


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
    """Samples (sample,) of complex64 and metadata of a SigMF recording; integers become fractions of full scale.

    Raises `FileNotFoundError` where a file is missing; `ValueError` where the metadata is damaged or names
    a datatype that is not complex, or the samples are not those of its checksum.
    """
    data, meta = (base.with_name(f"{base.name}.sigmf-{kind}") for kind in ("data", "meta"))
    try:
        metadata = json.loads(read_input(meta))
        datatype, checksum = metadata["global"]["core:datatype"], metadata["global"].get("core:sha512")
        float(metadata["global"].get("core:sample_rate", 1.0))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{meta}: not readable SigMF metadata ({error})") from error
    kind = re.fullmatch(r"c(f32|f64|i8|i16|i32)(_le|_be)?", str(datatype))
    if kind is None:
        raise ValueError(f"{meta}: core:datatype = {datatype}: must be {DATATYPE}, or ci16_le and its like")
    content = read_input(data)
    if checksum is not None and hashlib.sha512(content).hexdigest() != checksum:
        raise ValueError(f"{data}: differs from the core:sha512 of its metadata")
    number = np.dtype(f"{kind[1][0]}{int(kind[1][1:]) // 8}").newbyteorder(">" if kind[2] == "_be" else "<")
    if len(content) % (2 * number.itemsize):
        raise ValueError(f"{data}: {len(content)} bytes are no whole samples of {datatype}")
    ask_memory(READ_PER_BYTE * len(content), "its samples", str(data))
    full_scale = 1.0 if number.kind == "f" else 2.0 ** (8 * number.itemsize - 1)
    parts = np.frombuffer(content, number) / np.dtype(np.float32).type(full_scale)
    return parts.astype("<f4").view("<c8"), metadata
