"""Ray tracing with Sionna RT: line of sight, specular paths off flat faces and meshes, diffuse scattering.

Only this module imports Sionna, Mitsuba and Dr.Jit. The imports are inside functions, because they take seconds
and need a suitable LLVM library (`sim.propagation.llvm`).

Each receiver needs two solves, each on its own copy of the scene:

- specular: the facets of smooth contours absorb. So no path contains a flat-plate reflection off such a facet, and
  they do not fill the hashed candidate table of the solver, which silently drops paths. The facets of user meshes
  reflect as flat faces;
- diffuse: first-order scattering off all surfaces, also off the facets of curved ones.

Sionna scales every specular bounce by sqrt(1 - S^2), with or without diffuse scattering: the specular paths never
include the scattered share S^2 of the power.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from scenes.objects.material import Material
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import FloatArray, IntArray, concatenate
from scenes.scene import Scene
from sim.config import PropagationConfig
from sim.propagation.llvm import LLVM_VARIANT, mitsuba_variant, require_llvm
from sim.propagation.occlusion import surface_names
from sim.propagation.paths import BounceKind, Paths, empty_paths
from sim.propagation.specular.facets import TracedChains
from sim.propagation.traced import traced_paths

if TYPE_CHECKING:
    from scenes.meshes.mesh import MeshPart

CANDIDATE_TABLE_SIZE = 10_000_000  # the solver drops a path if its hash equals that of another path


class Tracer:
    """A scene loaded into the ray tracer; the methods compute one receiver position at a time.

    Raises `sim.propagation.llvm.LlvmError` if it runs on the CPU and there is no usable LLVM library.
    """

    def __init__(self, scene: Scene, carrier_hz: float, config: PropagationConfig | None = None) -> None:
        rt = _import_sionna()
        from scenes.meshes.mesh import object_meshes  # noqa: PLC0415

        self.config = config or PropagationConfig()
        self.carrier_hz = carrier_hz
        self._names = surface_names(scene)
        self._tx = np.asarray(scene.tx.position_m, float)
        self._solver = rt.PathSolver(deterministic=True)
        materials = scene.materials
        parts = object_meshes(scene, keep_hidden_caps=False)
        self._specular_scene = _LoadedScene(parts, materials, self._tx, carrier_hz, absorb_curved=True)
        scatters = any(materials[part.object_name].scattering_coefficient > 0 for part in parts)
        self._diffuse_scene = None
        if scatters and self.config.diffuse_samples and self.config.max_bounces:
            self._diffuse_scene = _LoadedScene(parts, materials, self._tx, carrier_hz, absorb_curved=False)

    def trace(self, rx_position_m: FloatArray) -> Paths:
        """Paths from the TX to one receiver (xyz,): line of sight, planar specular and diffuse.

        The same position always gives the same bits. The paths are in the order of the solver.
        """
        return concatenate([self.specular(rx_position_m), self.diffuse(rx_position_m)], "path")

    def specular(self, rx_position_m: FloatArray) -> Paths:
        """Line of sight and specular paths off flat faces to one receiver (xyz,), with the gains of Sionna."""
        return self.specular_chains(rx_position_m)[0]

    def specular_chains(self, rx_position_m: FloatArray) -> tuple[Paths, TracedChains]:
        """The same paths, and the triangles of their interactions, from one solve.

        With `transmission` this includes paths through faces. The solver then also returns paths with more than
        `max_bounces` reflections; they are removed.
        """
        rx = np.asarray(rx_position_m, float)
        loaded, n_slots = self._specular_scene, self.config.n_bounce_slots
        solved = self.solved_specular(rx)
        paths = self._record(loaded, rx, solved)
        kept = np.flatnonzero(paths.n_bounces <= self.config.max_bounces)
        paths = paths.take("path", kept)
        corner = np.full((len(paths), n_slots, 3, 3), np.nan)
        if len(paths):
            number, primitive = (of.numpy()[:, 0, 0].T[kept] for of in (solved.objects, solved.primitives))
            for path, slot in zip(*np.nonzero(paths.bounce_kind != BounceKind.NONE), strict=True):
                corner[path, slot] = loaded.triangles_of_id[int(number[path, slot])][primitive[path, slot]]
        return paths, TracedChains(paths.bounce_kind, paths.bounce_object, corner)

    def solved_specular(self, rx_position_m: FloatArray) -> Any:
        """The evaluated result of the solver for the specular paths: the minimum cost of `specular`."""
        config = self.config
        solved = self._solve(
            self._specular_scene, np.asarray(rx_position_m, float),
            max_depth=config.n_bounce_slots if config.transmission else config.max_bounces,
            samples_per_src=config.specular_samples,
            max_num_paths_per_src=CANDIDATE_TABLE_SIZE,
            los=True, specular_reflection=True, diffuse_reflection=False, refraction=config.transmission,
        )  # fmt: skip
        solved.tau.numpy()
        return solved

    def diffuse(self, rx_position_m: FloatArray) -> Paths:
        """First-order diffuse paths off all surfaces to one receiver (xyz,)."""
        if self._diffuse_scene is None:
            return empty_paths(self._names, self.config.n_bounce_slots)
        rx = np.asarray(rx_position_m, float)
        solved = self._solve(
            self._diffuse_scene, rx,
            max_depth=1,
            samples_per_src=self.config.diffuse_samples,
            max_num_paths_per_src=self.config.diffuse_samples,
            los=False, specular_reflection=False, diffuse_reflection=True, refraction=False,
        )  # fmt: skip
        return self._record(self._diffuse_scene, rx, solved)

    def _solve(self, loaded: _LoadedScene, rx: FloatArray, **options: Any) -> Any:
        loaded.move_receiver(rx)
        return self._solver(loaded.scene, **options)

    def _record(self, loaded: _LoadedScene, rx: FloatArray, solved: Any) -> Paths:
        if not solved.tau.shape[-1]:
            return empty_paths(self._names, self.config.n_bounce_slots)
        real, imaginary = (part.numpy()[0, 0, 0, 0] for part in solved.a)
        kind, surface = _interactions(solved, loaded.surface_of_id, self._names)
        return traced_paths(
            amplitude=real + 1j * imaginary,
            kind=kind,
            surface=surface,
            vertex=np.moveaxis(solved.vertices.numpy()[:, 0, 0], 0, 1).astype(float),
            ends=(self._tx, rx),
            carrier_hz=self.carrier_hz,
            names=self._names,
            n_slots=self.config.n_bounce_slots,
        )


def trace(
    scene: Scene, rx_positions_m: FloatArray, *, carrier_hz: float, config: PropagationConfig | None = None
) -> list[Paths]:
    """Paths to each receiver position (receiver, xyz), one record each; see `Tracer.trace`.

    Receivers are traced one at a time: the memory does not grow with their number, and the candidates of one
    receiver do not displace those of another one in the table.
    """
    tracer = Tracer(scene, carrier_hz, config)
    return [tracer.trace(position) for position in np.atleast_2d(rx_positions_m)]


class _LoadedScene:
    """A Sionna scene of triangle meshes with one isotropic, vertically polarised antenna at each end."""

    def __init__(
        self,
        parts: Sequence[MeshPart],
        materials: dict[str, Material],
        tx: FloatArray,
        carrier_hz: float,
        *,
        absorb_curved: bool,
    ) -> None:
        rt = _import_sionna()
        absorber = rt.AbsorberRadioMaterial("absorber")
        made = {
            material: _radio_material(index, material)
            for index, material in enumerate(dict.fromkeys(materials.values()))
        }
        objects = []
        self.surface_of_id: dict[int, str] = {}
        self.triangles_of_id: dict[int, FloatArray] = {}
        for index, part in enumerate(parts):
            absorbs = absorb_curved and part.is_curved
            item = _mesh_object(f"part-{index}", part, absorber if absorbs else made[materials[part.object_name]])
            self.surface_of_id[int(item.object_id)] = part.object_name
            self.triangles_of_id[int(item.object_id)] = np.asarray(part.mesh.vertices)[part.mesh.faces]
            objects.append(item)
        self.scene = rt.Scene()
        self.scene.frequency = carrier_hz  # before the objects: an absorber cannot follow a change
        self.scene.edit(add=objects)
        antenna = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
        self.scene.tx_array = self.scene.rx_array = antenna
        self._receiver = rt.Receiver("rx", position=_point(tx))
        self.scene.add([rt.Transmitter("tx", position=_point(tx)), self._receiver])

    def move_receiver(self, position_m: FloatArray) -> None:
        self._receiver.position = _point(position_m)


def _import_sionna() -> Any:
    """The module sionna.rt, on CUDA if there is a device, else on LLVM."""
    chosen = mitsuba_variant()
    if chosen == LLVM_VARIANT:
        require_llvm()
    import mitsuba as mi  # noqa: PLC0415

    if mi.variant() is None:
        mi.set_variant(chosen)
    import sionna.rt  # noqa: PLC0415

    return sionna.rt


def _point(position_m: FloatArray) -> Any:
    import mitsuba as mi  # noqa: PLC0415

    return mi.Point3f(*(float(part) for part in position_m))


def _radio_material(index: int, material: Material) -> Any:
    directivity = material.scattering_directivity
    pattern: dict[str, Any] = {"scattering_pattern": "lambertian"}
    if directivity is not None:
        pattern = {"scattering_pattern": "directive", "alpha_r": directivity}
    return _import_sionna().RadioMaterial(
        f"material-{index}",
        thickness=material.thickness_m,
        relative_permittivity=material.relative_permittivity,
        conductivity=material.conductivity_s_m,
        scattering_coefficient=material.scattering_coefficient,
        **pattern,
    )


def _mesh_object(name: str, part: MeshPart, radio_material: Any) -> Any:
    """Sionna object of the triangles, with the normals of the flat faces."""
    rt = _import_sionna()
    import mitsuba as mi  # noqa: PLC0415

    properties = mi.Properties()
    properties.set_id(name)
    properties["face_normals"] = True
    properties["mesh_bsdf"] = radio_material
    vertices, faces = np.asarray(part.mesh.vertices), np.asarray(part.mesh.faces)
    mesh = mi.Mesh(name, len(vertices), len(faces), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return rt.SceneObject(mi_mesh=mesh, name=name, radio_material=radio_material)


def _interactions(solved: Any, surface_of_id: dict[int, str], names: list[str]) -> tuple[IntArray, IntArray]:
    """BounceKind and surface index, each (path, bounce), from the solver's codes and object numbers."""
    codes = _import_sionna().InteractionType
    kind_of_code = {
        int(codes.NONE): BounceKind.NONE,
        int(codes.SPECULAR): BounceKind.SPECULAR,
        int(codes.DIFFUSE): BounceKind.DIFFUSE,
        int(codes.REFRACTION): BounceKind.REFRACTION,
        int(codes.DIFFRACTION): BounceKind.DIFFRACTION,
    }
    index_of_id = {number: names.index(name) for number, name in surface_of_id.items()}
    code, number = solved.interactions.numpy()[:, 0, 0].T, solved.objects.numpy()[:, 0, 0].T
    kind = np.vectorize(kind_of_code.__getitem__, otypes=[int])(code)
    surface = np.full(kind.shape, -1)
    used = kind != BounceKind.NONE
    surface[used] = [index_of_id[int(one)] for one in number[used]]
    return kind, surface


def solved_between_panels(
    scene: Scene, rx: Pose, carrier_hz: float, config: PropagationConfig, *, rows: int, columns: int
) -> tuple[Any, FloatArray]:
    """Specular paths between two half-wavelength panels of TR 38.901 elements, in the form of Sionna.

    Panels look along the headings of their devices. Returns the result of the solver, whose `cfr` is the channel
    between all elements, and the element positions (element, xyz) in m, in the same order and in the panel frame.
    """
    rt = _import_sionna()
    import mitsuba as mi  # noqa: PLC0415

    tracer = Tracer(scene, carrier_hz, config)
    loaded = tracer._specular_scene.scene
    panel = rt.PlanarArray(num_rows=rows, num_cols=columns, pattern="tr38901", polarization="V")
    loaded.tx_array = loaded.rx_array = panel
    for device, pose in ((loaded.transmitters["tx"], scene.tx), (loaded.receivers["rx"], rx)):
        device.orientation = mi.Point3f(float(pose.heading_rad), 0.0, 0.0)
    solved = tracer.solved_specular(rx.position_m)
    return solved, np.asarray(panel.positions(SPEED_OF_LIGHT_M_S / carrier_hz).numpy().T, float)
