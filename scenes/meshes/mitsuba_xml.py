"""The Mitsuba scene file of a scene, with the radio materials of Sionna RT."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping

from scenes.objects.material import Material

MITSUBA_VERSION = "2.1.0"
PREFIX = (
    "mat-arena-"  # names that are those of ITU materials, or start with itu, mean something else to Sionna
)


def mitsuba_xml(materials: Mapping[str, Material], shapes: Iterable[tuple[str, str, str]]) -> str:
    """XML text of the materials by name and the shapes (id, PLY file, name of the material).

    Every material is a `radio-material` with its constants at the carrier written out; Lambertian scattering is
    what Sionna assumes then.
    """
    root = ET.Element("scene", version=MITSUBA_VERSION)
    for name, material in materials.items():
        node = ET.SubElement(root, "bsdf", type="radio-material", id=PREFIX + name)
        for constant, value in (
            ("relative_permittivity", material.relative_permittivity),
            ("conductivity", material.conductivity_s_m),
            ("thickness", material.thickness_m),
            ("scattering_coefficient", material.scattering_coefficient),
        ):
            ET.SubElement(node, "float", name=constant, value=repr(float(value)))
    for name, file, material_name in shapes:
        node = ET.SubElement(root, "shape", type="ply", id=f"mesh-{name}")
        ET.SubElement(node, "string", name="filename", value=file)
        ET.SubElement(node, "boolean", name="face_normals", value="true")
        ET.SubElement(node, "ref", id=PREFIX + material_name, name="bsdf")
    ET.indent(root, space="    ")
    return ET.tostring(root, encoding="unicode") + "\n"
