"""Specular reflection off flat vertical faces by images, in plan view.

A chain of faces is kept only where each face can be lit through the one before, seen from the TX; the chains and
the images of the TX do not depend on the receivers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.record import BoolArray, FloatArray, IntArray, Record, array
from sim.propagation.specular.plan_view import PlanPaths, cross, norm
from sim.propagation.specular.surfaces import Faces

CLEARANCE_M = 1e-9  # a point or a part of a face nearer than this to a plane is not in front of it


@dataclass(frozen=True)
class FaceChains(Record):
    """Sequences of faces and the image of the TX in the first, first two, ... of them."""

    face: IntArray = array("chain", "corner", dtype=int, doc="faces in the order they are met")
    image_m: FloatArray = array("chain", "image", "xy", unit="m", doc="TX, then its images")

    def __len__(self) -> int:
        return self.size("chain")


def face_chains(faces: Faces, tx_xy_m: FloatArray, max_corners: int) -> list[FaceChains]:
    """All chains of 1 ... `max_corners` faces that can reflect the wave of a TX (xy,), one record per length."""
    every = np.arange(faces.size("face"))
    first = every[faces.height_over(every, tx_xy_m[None]) > CLEARANCE_M]
    image = faces.mirror(first, tx_xy_m[None])
    tx = np.broadcast_to(tx_xy_m, image.shape)
    found = [FaceChains(first[:, None], np.stack([tx, image], axis=1))]
    facing = _facing(faces)
    while len(found) < max_corners:
        found.append(_extended(found[-1], faces, facing))
    return found[:max_corners]


def planar_paths(faces: Faces, chain: FaceChains, rx_xy_m: FloatArray) -> PlanPaths:
    """Paths to receivers (receiver, xy) over all chains of one length, occlusion left aside."""
    n = chain.size("corner")
    last = chain.face[:, -1]
    hit, row = np.nonzero(faces.height_over(last[None], rx_xy_m[:, None]) > CLEARANCE_M)
    target = rx_xy_m[hit]
    points: list[FloatArray] = []
    for corner in reversed(range(n)):
        point, valid = points_on_faces(faces, chain.face[row, corner], chain.image_m[row, corner + 1], target)
        hit, row, target = hit[valid], row[valid], point[valid]
        points = [target, *(earlier[valid] for earlier in points)]
    face = chain.face[row]
    return PlanPaths(
        hit, faces.surface[face], np.stack(points, axis=1), faces.normal[face], np.zeros(face.shape)
    )


def points_on_faces(
    faces: Faces, face: IntArray, image_m: FloatArray, target_m: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Where the line from targets (n, xy) to images (n, xy) meets faces (n,), and whether it does.

    The target has to lie on the lit side and the image behind the face.
    """
    before = faces.height_over(face, target_m)
    behind = -faces.height_over(face, image_m)
    valid = (before > CLEARANCE_M) & (behind > CLEARANCE_M)
    share = before / np.where(valid, before + behind, 1.0)
    point = target_m + share[:, None] * (image_m - target_m)
    start, end = faces.start_m[face], faces.end_m[face]
    along = end - start
    offset = point - start
    position = along[:, 0] * offset[:, 0] + along[:, 1] * offset[:, 1]
    valid &= (position >= 0) & (position <= along[:, 0] ** 2 + along[:, 1] ** 2)
    return point, valid


def is_outside_beam(
    faces: Faces, face: IntArray, image_m: FloatArray, center_m: FloatArray, reach_m: FloatArray
) -> BoolArray:
    """Whether discs (..., xy), (...) lie outside the beams that images (..., xy) send through faces (...)."""
    low, high = _rim_distances(faces, face, image_m, center_m)
    limit = -reach_m - CLEARANCE_M
    return np.asarray((low < limit) | (high < limit))


def _extended(chain: FaceChains, faces: Faces, facing: BoolArray) -> FaceChains:
    last = chain.face[:, -1]
    row, following = np.nonzero(facing[last])
    image = chain.image_m[row, -1]
    lit = faces.height_over(following, image) > CLEARANCE_M
    ends = [_rim_distances(faces, last[row], image, end[following]) for end in (faces.start_m, faces.end_m)]
    for at_start, at_end in zip(*ends, strict=True):
        lit &= (at_start > -CLEARANCE_M) | (at_end > -CLEARANCE_M)
    row, following, image = row[lit], following[lit], image[lit]
    images = np.concatenate([chain.image_m[row], faces.mirror(following, image)[:, None]], axis=1)
    return FaceChains(np.column_stack([chain.face[row], following]), images)


def _rim_distances(
    faces: Faces, face: IntArray, image_m: FloatArray, point_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances (...) of points from the two rims of beams, positive towards the inside.

    Seen from the image, behind the face and so to the left of start -> end, the end lies left of the start.
    """
    to_start, to_end = faces.start_m[face] - image_m, faces.end_m[face] - image_m
    offset = point_m - image_m
    return cross(to_start, offset) / norm(to_start), -cross(to_end, offset) / norm(to_end)


def _facing(faces: Faces) -> BoolArray:
    """Whether a part of each face (face, .) lies in front of each other face (., face) and the other way round."""
    every = np.arange(faces.size("face"))
    over = np.maximum(
        faces.height_over(every[None], faces.start_m[:, None]),
        faces.height_over(every[None], faces.end_m[:, None]),
    )
    front = over > CLEARANCE_M
    return np.asarray(front & front.T)
