"""The datasheet of a data set (Gebru et al., Datasheets for Datasets, 2021)."""

from typing import Any

import tomli_w

from isac_arena.datasets.config import DatasetConfig
from isac_arena.datasets.samples import ABOUT, fields_of


def datasheet(config: DatasetConfig, counts: dict[str, Any]) -> str:
    """What a data set holds and how it was made, as Markdown."""
    rows = "\n".join(
        f"| {split} | {one['scenes']} | {one['stops']} | {1e-6 * one['bytes']:.1f} |"
        for split, one in counts.items()
    )
    fields = "\n".join(f"- `{field}` {ABOUT[field]}." for field in fields_of(config))
    low, high = config.scenes.difficulty
    settings = tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))
    return f"""# {config.name}

Simulated radio measurements of random rooms at receiver stops, for learning to see rooms by radio. All of it is
made by ISAC Arena from the specification below: no person and no place was measured.

| split | scenes | stops | MB |
|---|---|---|---|
{rows}

A scene is in one split, with all its stops. Scenes are random arenas (`isac_arena.random_arena`) of a difficulty
between {low:g} and {high:g}: walled rooms with pillars, partitions and boxes of random materials, a TX and a
random walk.

## Fields

Each stop has these arrays, as `.npy` members of tar files (`SCENE_STOP.FIELD.npy`; `SCENE.FIELD.npy` where all
stops of a scene share it). WebDataset and `ia.datasets.open(DIRECTORY, split)` read them.

{fields}

## What it is not

Simulation has the limits of its model: ray-traced paths, first-order diffraction, nominal or stated hardware
errors, objects as prisms. What a network learns here has to be shown on measured data before it is believed there.
Truth (`paths`, `pose`, `contours`, `occupancy`) is exact; receivers would not have it.

## Making and checking

`arena dataset SPEC.toml --out DIRECTORY` makes the same bytes from this specification with the same version, for
any number of workers. `sha256sum -c SHA256SUMS` checks the files. Licence: {config.licence}.

```toml
{settings}```
"""
