"""Places where a TX could stand: TX of the scene by name, the lines of a file, or a grid over the free floor."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenes.inputs import read_input
from scenes.pose import Pose
from scenes.record import FloatArray
from scenes.scene import Scene

ALL = "all"
GRID = "grid:"
COLUMNS = ("name", "x_m", "y_m", "z_m", "heading_deg")
MIN_CLEARANCE_M = 0.3  # of a place of the grid from objects
MAX_CANDIDATES = 500


@dataclass(frozen=True)
class Candidate:
    """A TX that could be: its name and pose."""

    name: str
    pose: Pose


def read_candidates(text: str, scene: Scene, n_headings: int = 1) -> list[Candidate]:
    """Candidates of an option.

    Parameters
    ----------
    text
        `all` or names of TX of the scene with commas between; a CSV file with the columns of `COLUMNS`; or
        `grid:STEP`: places STEP m apart over the free floor, at the height of the first TX, that look at the
        middle of the walk.
    n_headings
        Headings of every candidate, evenly spaced from its own: an orientation is then chosen as well.

    Raises `ValueError` for what is none of these, and where there are too many.
    """
    if text.startswith(GRID):
        found = _grid(text, scene)
    elif text.endswith(".csv"):
        found = _file(Path(text))
    else:
        names = list(scene.txs) if text == ALL else [name.strip() for name in text.split(",")]
        unknown = [name for name in names if name not in scene.txs]
        if unknown:
            allowed = f"{', '.join(scene.txs)}, {ALL}, a .csv file or {GRID}STEP"
            raise ValueError(f"--candidates = {text}: '{unknown[0]}' must be one of {allowed}")
        found = [Candidate(name, scene.txs[name]) for name in names]
    if len({each.name for each in found}) < len(found):
        raise ValueError(f"--candidates = {text}: a name is given twice, every candidate needs its own")
    turned = [_turned(each, k, n_headings) for each in found for k in range(n_headings)]
    if not 0 < len(turned) <= MAX_CANDIDATES:
        raise ValueError(
            f"--candidates = {text}: gives {len(turned)} candidates, 1 to {MAX_CANDIDATES} are allowed"
        )
    return turned


def _turned(candidate: Candidate, number: int, n_headings: int) -> Candidate:
    """A candidate turned by a share of a full turn, which its name tells where there are several."""
    if n_headings == 1:
        return candidate
    turn_rad = 2 * np.pi * number / n_headings
    pose = candidate.pose
    name = f"{candidate.name}@{round(np.rad2deg(pose.heading_rad + turn_rad)) % 360}"
    return Candidate(name, Pose(pose.position_m, pose.heading_rad + turn_rad))


def _grid(text: str, scene: Scene) -> list[Candidate]:
    try:
        step_m = float(text.removeprefix(GRID))
    except ValueError:
        step_m = np.nan
    if not 0.1 <= step_m <= 100:
        raise ValueError(f"--candidates = {text}: the step after {GRID} must be 0.1 to 100 m")
    low, high = np.array(scene.bounds_m[:2]), np.array(scene.bounds_m[2:])
    x, y = (np.arange(low[axis] + step_m / 2, high[axis], step_m) for axis in (0, 1))
    middle = scene.walk.positions_m()[:, :2].mean(axis=0)
    places = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), scene.tx.position_m[2])], axis=-1)
    return [
        Candidate(f"at_{place[0]:.1f}_{place[1]:.1f}", Pose(place, float(np.arctan2(*(middle - place[:2])[::-1]))))
        for place in places[_is_free(scene, places)]
    ]


def _is_free(scene: Scene, places: FloatArray) -> FloatArray:
    """Whether places (..., xyz) keep their distance from all objects, and lie in no mesh."""
    free = scene.is_free(places)
    for item in scene.objects:
        level = (places[..., 2] >= item.z_min_m) & (places[..., 2] <= item.z_max_m)
        near = np.abs(item.contour.signed_distance(places[..., :2])) < MIN_CLEARANCE_M
        free &= ~(level & near)
    return np.asarray(free)


def _file(path: Path) -> list[Candidate]:
    lines = [line.strip() for line in read_input(path).decode("utf-8-sig", "replace").splitlines() if line.strip()]
    head = tuple(cell.strip() for cell in lines[0].split(",")) if lines else ()
    if head != COLUMNS:
        raise ValueError(f"{path}: the first line is '{','.join(head)}', must be '{','.join(COLUMNS)}'")
    found = []
    for number, line in enumerate(lines[1:], 2):
        name, *cells = (cell.strip() for cell in line.split(","))
        try:
            x, y, z, heading_deg = map(float, cells)
        except ValueError:
            raise ValueError(f"{path}: line {number} = '{line[:60]}', must be a name and four numbers") from None
        if not np.isfinite([x, y, z, heading_deg]).all():
            raise ValueError(f"{path}: line {number} = '{line[:60]}', every number must be finite")
        found.append(Candidate(name, Pose(np.array([x, y, z]), float(np.deg2rad(heading_deg)))))
    return found
