"""The closed contour of a kind that our estimator knows that is nearest to a true outline."""

import numpy as np
from scipy.optimize import least_squares

from estimation.laws.support import CLOSED_FAMILY, support
from estimation.shape.reflection.bounds import KnownContour
from scenes.record import FloatArray
from scenes.scene import Scene, SceneObject

SAME_M = 1e-3  # a circle as near as this to the outline is the outline
SPACING_M = 0.005  # of the points of a true outline
_N_NORMALS = 90
_TURNS = np.arange(4)


def pillars(scene: Scene) -> list[SceneObject]:
    """The objects with a closed outline that a contour can show: the pillars of a scene."""
    return [item for item in scene.fixtures if item.kind == "pillar" and item.contour.closed]


def known_contour(item: SceneObject) -> KnownContour:
    """The circle, ellipse or rounded square with the nearest tangents, by least squares over all normals.

    The outline of an object that is not convex counts as its convex hull: tangents see no more.
    """
    psi = np.linspace(-np.pi, np.pi, _N_NORMALS, endpoint=False)
    normal = np.column_stack([np.cos(psi), np.sin(psi)])
    outline = item.contour.sample(SPACING_M)
    distance = (outline @ normal.T).max(axis=0)
    area = item.contour.area_m2()
    place = np.append(outline.mean(axis=0), np.log(np.sqrt(area / np.pi)))
    best: tuple[float, str, FloatArray] | None = None
    for kind, shapes in _STARTS.items():
        for shape in shapes:
            found = least_squares(_gap, np.append(place, shape), args=(CLOSED_FAMILY[kind], psi, normal, distance))
            size = float(np.sqrt(np.mean(found.fun**2)))
            if best is None or size < best[0]:
                best = size, kind, found.x
        if best is not None and best[0] < SAME_M:
            break
    if best is None:
        raise ValueError(f"object '{item.name}': no contour fits its outline")
    return KnownContour(item.name, best[1], best[2])


def _gap(
    parameter: FloatArray, family: int, psi: FloatArray, normal: FloatArray, distance: FloatArray
) -> FloatArray:
    value, _ = support(family, parameter, psi)
    return np.asarray(normal @ parameter[:2] + value[:, 0] - distance)


_STARTS: dict[str, list[FloatArray]] = {
    "circle": [np.zeros(0)],
    "ellipse": [0.4 * np.array([np.cos(turn), np.sin(turn)]) for turn in _TURNS * np.pi / 2],
    "rounded_square": [np.array([-1.0, turn]) for turn in (_TURNS + 0.5) * np.pi / 8],
}
