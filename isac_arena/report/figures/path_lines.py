"""How propagation paths look in plan and in space: the paths drawn, their colours and their opacity."""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, IntArray
from sim.propagation.paths import BounceKind, Paths

N_DRAWN = 80  # strongest paths drawn as lines
FAINTEST_DB = 40.0  # a line this far below the strongest path has the least opacity
LEAST_OPACITY, MOST_OPACITY = 0.2, 0.95
N_SCATTER_POINTS = 4000
SCATTER_COLOR = "#D55E00"
COLORS = {  # Okabe and Ito (2008)
    "line of sight": "#000000",
    "one reflection": "#0072B2",
    "two reflections": "#E69F00",
    "three reflections": "#009E73",
    "diffracted": "#CC79A7",
    "through walls": "#56B4E9",
    "over a target": "#7A4B1F",
}
DASHES: dict[str, tuple[float, ...]] = {  # on, off, ... in line widths, so that kinds differ without colours
    "line of sight": (),
    "one reflection": (),
    "two reflections": (6.0, 2.0),
    "three reflections": (2.0, 2.0),
    "diffracted": (6.0, 2.0, 1.5, 2.0),
    "through walls": (1.0, 1.5),
    "over a target": (4.0, 1.5),
}


@dataclass(frozen=True)
class PathLine:
    """One path to draw: its corners (point, xyz) in m from TX to RX, its kind and its opacity."""

    points_m: FloatArray
    kind: str
    opacity: float


def path_lines(paths: Paths, tx_m: FloatArray, rx_m: FloatArray) -> list[PathLine]:
    """The strongest paths that are not diffuse, weakest first, so that strong ones are drawn on top."""
    drawn = paths.take("path", ~paths.is_diffuse)
    level_db = 10 * np.log10(np.maximum(drawn.power, 1e-300))
    lines = []
    for index in np.argsort(level_db, kind="stable")[-N_DRAWN:]:
        n = int(drawn.n_interactions[index])
        strength = np.clip(1 - (level_db.max() - level_db[index]) / FAINTEST_DB, 0, 1)
        lines.append(
            PathLine(
                np.vstack([tx_m, drawn.vertex_m[index, :n], rx_m]),
                path_kind(drawn.bounce_kind[index, :n]),
                float(LEAST_OPACITY + (MOST_OPACITY - LEAST_OPACITY) * strength),
            )
        )
    return lines


def scatter_points(paths: Paths) -> FloatArray:
    """Scattering points (point, xyz) in m of the strongest diffuse paths."""
    diffuse = paths.take("path", paths.is_diffuse)
    strongest = np.argsort(-diffuse.power, kind="stable")[:N_SCATTER_POINTS]
    return np.asarray(diffuse.vertex_m[strongest, 0])


def path_summary(paths: Paths) -> str:
    """The numbers of specular and diffuse paths as text."""
    n_diffuse = int(paths.is_diffuse.sum())
    n_drawn = min(len(paths) - n_diffuse, N_DRAWN)
    shown = f" (the {n_drawn} strongest drawn)" if n_drawn < len(paths) - n_diffuse else ""
    return f"{len(paths) - n_diffuse} paths{shown}, {n_diffuse} diffuse"


def line_style(kind: str) -> tuple[float, tuple[float, ...] | None]:
    """The dashes of a kind of path in matplotlib's form."""
    return 0.0, DASHES[kind] or None


def path_kind(bounces: IntArray) -> str:
    """The kind of a path by the `BounceKind` (bounce,) of all its interactions, one of `COLORS`."""
    if np.any(bounces == BounceKind.TARGET):
        return "over a target"
    if np.any(bounces == BounceKind.DIFFRACTION):
        return "diffracted"
    if np.any(bounces == BounceKind.REFRACTION):
        return "through walls"
    names = ("line of sight", "one reflection", "two reflections", "three reflections")
    return names[min(len(bounces), 3)]
