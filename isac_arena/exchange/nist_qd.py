"""Outputs of NIST's Q-D realization software: rooms with their specular paths, and echoes of a moving target."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from scenes.record import FloatArray

ENVIRONMENT, TRANSMITTERS, RECEIVERS = "L-Room.xml", "NodePosition0.dat", "NodePosition1.dat"
PATHS = "qdOutput.json"
FILES = (ENVIRONMENT, TRANSMITTERS, RECEIVERS, PATHS)
TARGET_PLACES, ECHOES = "TargetBase0.dat", "qdTargetOutput.json"
TARGET_FILES = ("NodePosition0.dat", "NodePosition1.dat", TARGET_PLACES, ECHOES)
COLUMNS = ("Delay", "AODAZ", "AODEL", "AOAAZ", "AOAEL")
SPEED_M_S = 3e8  # of light, there


@dataclass(frozen=True)
class NistRoom:
    """A room with one TX and the paths to every place of the receiver."""

    walls_m: dict[str, FloatArray]  # (end, xy) in plan view, of the upright walls
    tx_m: FloatArray  # (xyz,)
    rx_m: FloatArray  # (place, xyz)
    paths: list[FloatArray]  # (path, 5) per place: length in m, azimuth and elevation of departure and arrival


def read_nist_room(folder: Path) -> NistRoom:
    """The room in a folder that holds `FILES`: lengths in m, angles in rad, elevations from the horizontal."""
    walls = {}
    for item in ElementTree.parse(folder / ENVIRONMENT).getroot().iter("object"):
        corners = [[float(str(place.findtext(axis))) for axis in "xyz"] for place in item.iter("coordinates")]
        low, high = np.min(corners, axis=0) / 1e3, np.max(corners, axis=0) / 1e3  # the file has mm
        if (high - low)[:2].min() == 0:
            walls[str(item.findtext("metadata"))] = np.stack([low[:2], high[:2]])
    first_line = (folder / PATHS).read_text(encoding="utf-8").splitlines()[0]  # TX to receiver; then the way back
    tx_m, rx_m = (np.loadtxt(folder / name, delimiter=",") for name in (TRANSMITTERS, RECEIVERS))
    return NistRoom(walls, tx_m[0], rx_m, _paths(json.loads(first_line)))


@dataclass(frozen=True)
class NistTarget:
    """A point that moves, and its echoes: one path over it at every time."""

    tx_m: FloatArray  # (xyz,)
    rx_m: FloatArray  # (xyz,)
    target_m: FloatArray  # (time, xyz)
    echo: FloatArray  # (time, 5): length in m, azimuth and elevation of departure and of arrival in rad
    phase_rad: FloatArray  # (time,) of the carrier: plus 2 pi times the length in wavelengths


def read_nist_target(folder: Path) -> NistTarget:
    """The moving target in a folder that holds `TARGET_FILES`; as `read_nist_room`."""
    line = json.loads((folder / ECHOES).read_text(encoding="utf-8").splitlines()[0])
    names = ("delay", "aodAz", "aodEl", "aoaAz", "aoaEl")
    echoes = _paths({given: line[name] for given, name in zip(COLUMNS, names, strict=True)})
    places = [np.loadtxt(folder / name, delimiter=",") for name in TARGET_FILES[:3]]
    phase = np.array(line["phase"])[:, 0]
    return NistTarget(places[0], places[1], places[2][: len(phase)], np.concatenate(echoes), phase)


def _paths(line: dict[str, Any]) -> list[FloatArray]:
    columns = (line[name] for name in COLUMNS)
    places = []
    for delay_s, *angles_deg in zip(*columns, strict=True):
        azimuth, zenith = np.deg2rad(angles_deg[::2]), np.deg2rad(angles_deg[1::2])
        elevation, length_m = np.pi / 2 - zenith, SPEED_M_S * np.array(delay_s)
        places.append(np.column_stack([length_m, azimuth[0], elevation[0], azimuth[1], elevation[1]]))
    return places
