"""Damaged files: five kinds of damage, and inputs of every format that a scene or a campaign can name."""

import json
import random
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.io import netcdf_file, savemat

from isac_arena.campaign.netcdf import to_netcdf
from scenes.meshes.mesh import mesh_bytes
from scenes.record import FloatArray, IntArray, Record, array

Damage = Callable[[bytes, random.Random], bytes | None]


def _flipped(content: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(content) or 1)
    return content[:at] + bytes([content[at] ^ (1 << rng.randrange(8))]) + content[at + 1 :] if content else b"\1"


DAMAGES: dict[str, Damage] = {
    "flip": _flipped,
    "truncate": lambda content, rng: content[: rng.randrange(len(content) or 1)],
    "zero": lambda content, rng: bytes(len(content)),
    "delete": lambda content, rng: None,
    "random": lambda content, rng: rng.randbytes(max(len(content), 16)),
}

PLAN_TAIL = """
[[floorplans]]
name = "plan"
file = "plan.{plan}"
material = "plasterboard"
z_max_m = 2.0
"""
SCENE_TAIL = (
    PLAN_TAIL
    + """
[[meshes]]
name = "crate"
file = "crate.{mesh}"
material = "wood"
position_m = [3.0, 6.0, 0.6]
"""
)
PLANS = ("csv", "geojson")
CORNERS_M = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float) - 0.2  # of a tetrahedron
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
MESHES = ("obj", "stl", "ply", "off", "glb", "zip")


@dataclass(frozen=True)
class MadePaths(Record):
    """A table of measured paths: two at each of two stops."""

    stop: IntArray = array("path", dtype=int)
    range_m: FloatArray = array("path", unit="m")
    aod_azimuth_rad: FloatArray = array("path", unit="rad")
    aoa_azimuth_rad: FloatArray = array("path", unit="rad")
    power_dbm: FloatArray = array("path", unit="dBm")
    rx_x_m: FloatArray = array("path", unit="m")
    rx_y_m: FloatArray = array("path", unit="m")
    rx_heading_rad: FloatArray = array("path", unit="rad")


PATHS = MadePaths(
    np.array([0, 0, 1, 1]), np.array([4.0, 6.0, 5.0, 7.0]), np.array([0.1, 0.2, 0.3, 0.4]),
    np.array([-0.1, -0.2, -0.3, -0.4]), np.array([-40.0, -50.0, -45.0, -55.0]), np.array([4.0, 4.0, 5.0, 5.0]),
    np.full(4, 2.0), np.zeros(4),
)  # fmt: skip
TABLES = ("csv", "parquet", "mat", "nc", "h5")


def write_tables(folder: Path) -> list[str]:
    """A table of measured paths in every format; returns the names of the files."""
    columns = {spec.name: getattr(PATHS, spec.name) for spec in fields(PATHS)}
    rows = zip(*(value.tolist() for value in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    (folder / "paths.csv").write_text("\n".join(lines), encoding="utf-8")
    packed = BytesIO()
    pq.write_table(pa.table({name: pa.array(value) for name, value in columns.items()}), packed)
    (folder / "paths.parquet").write_bytes(packed.getvalue())
    saved = BytesIO()
    savemat(saved, columns, do_compression=True)
    (folder / "paths.mat").write_bytes(saved.getvalue())
    (folder / "paths.h5").write_bytes(to_netcdf(PATHS, {}))
    with netcdf_file(folder / "paths.nc", "w") as stored:
        stored.createDimension("path", len(PATHS.stop))
        for name, value in columns.items():
            stored.createVariable(name, "f8", ("path",))[:] = value
    return [f"paths.{kind}" for kind in TABLES]


def write_inputs(folder: Path) -> list[str]:
    """Inputs of every format, and the settings files that name them; returns the names of the settings files."""
    (folder / "plan.csv").write_text("x0_m,y0_m,x1_m,y1_m\n2.0,5.2,5.0,5.2\n", encoding="utf-8")
    line = {"type": "LineString", "coordinates": [[2.0, 5.2], [5.0, 5.2]]}
    (folder / "plan.geojson").write_text(json.dumps(line), encoding="utf-8")
    (folder / "way.tum").write_text("0 4 2 1.5 0 0 0 1\n1 5 2 1.5 0 0 0 1\n", encoding="utf-8")
    (folder / "way.csv").write_text("4,2,1.5,0\n5,2,1.5,0\n", encoding="utf-8")
    for kind in MESHES[:-1]:
        (folder / f"crate.{kind}").write_bytes(mesh_bytes(CORNERS_M, FACES, kind))
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(folder / "crate.obj", "crate.obj")
    (folder / "crate.zip").write_bytes(packed.getvalue())
    np.savez_compressed(folder / "beams.npz", weights=np.eye(8, dtype=complex))
    (folder / "beams.csv").write_text(("1+0j," * 8).rstrip(",") + "\n", encoding="utf-8")
    room = (folder / "room.toml").read_text(encoding="utf-8")
    head, _, rest = room.partition("[walk]")
    names = []
    for number, mesh in enumerate(MESHES):
        tail = SCENE_TAIL.format(plan=PLANS[number % 2], mesh=mesh)
        names.append(f"scene_{mesh}.toml")
        (folder / names[-1]).write_text(room + tail, encoding="utf-8")
    for walk in ('type = "tum"\nfile = "way.tum"', 'type = "poses"\nfile = "way.csv"'):
        names.append(f"scene_{walk[-4:-1]}.toml")
        text = f"{head}[walk]\n{walk}\n\n[{rest.partition(chr(10) + '[')[2]}"
        (folder / names[-1]).write_text(text, encoding="utf-8")
    small = (folder / "small.toml").read_text(encoding="utf-8")
    for kind in ("npz", "csv"):
        names.append(f"campaign_{kind}.toml")
        text = small.replace("beams_per_panel = 8\n", f'codebook = "file"\nweights_file = "beams.{kind}"\n', 1)
        (folder / names[-1]).write_text(text, encoding="utf-8")
    return names
