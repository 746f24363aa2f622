"""Specular reflection off flat vertical faces by the image method, in plan view.

A chain of faces is kept only if each face can be illuminated through the previous one. The chains and the images
of the TX do not depend on the receivers.
"""

from dataclasses import dataclass

import numpy as np

from scenes.record import BoolArray, FloatArray, IntArray, Record, array
from sim.propagation.specular.plan_view import PlanPaths, cross, norm
from sim.propagation.specular.surfaces import Faces

CLEARANCE_M = 1e-9  # a point nearer than this to the plane of a face is not in front of it


@dataclass(frozen=True)
class FaceChains(Record):
    """Sequences of faces, and the image of the TX in the first face, the first two faces, and so on."""

    face: IntArray = array("chain", "corner", dtype=int, doc="faces in order from TX to RX")
    image_m: FloatArray = array("chain", "image", "xy", unit="m", doc="TX, then its images")

    def __len__(self) -> int:
        return self.size("chain")


def face_chains(faces: Faces, tx_xy_m: FloatArray, max_corners: int) -> list[FaceChains]:
    """All chains of 1 to `max_corners` faces that can reflect the wave of a TX (xy,), one record per length."""
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
    """Paths to receivers (receiver, xy) over all chains of one length, without test for occlusion."""
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
    return PlanPaths(hit, faces.surface[face], np.stack(points, axis=1), faces.normal[face], np.zeros(face.shape))


def points_on_faces(
    faces: Faces, face: IntArray, image_m: FloatArray, target_m: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Intersections (n, xy) of lines from targets (n, xy) to images (n, xy) with faces (n,), and a mask (n,).

    The target must lie on the lit side and the image behind the face.
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
    """Whether discs (..., xy), (...) lie outside the beams from images (..., xy) through faces (...)."""
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
    """Distances (...) of points from the two edges of beams, positive inside.

    The image lies behind the face, to the left of start -> end. Seen from it, the end is left of the start.
    """
    to_start, to_end = faces.start_m[face] - image_m, faces.end_m[face] - image_m
    offset = point_m - image_m
    return cross(to_start, offset) / norm(to_start), -cross(to_end, offset) / norm(to_end)


def _facing(faces: Faces) -> BoolArray:
    """Mask (face, face) of pairs of faces that each have a part in front of the other face."""
    every = np.arange(faces.size("face"))
    over = np.maximum(
        faces.height_over(every[None], faces.start_m[:, None]),
        faces.height_over(every[None], faces.end_m[:, None]),
    )
    front = over > CLEARANCE_M
    return np.asarray(front & front.T)
