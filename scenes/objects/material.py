"""Materials at the carrier frequency: the ITU-R P.2040-3 table and custom ones."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

VACUUM_PERMITTIVITY_F_M = 8.854_187_8128e-12


class ItuRow(NamedTuple):
    """One row of ITU-R P.2040-3, table 3: eps_r = a f^b and sigma = c f^d with f in GHz."""

    a: float
    b: float
    c: float
    d: float
    f_min_ghz: float
    f_max_ghz: float


ITU_TABLE: dict[str, tuple[ItuRow, ...]] = {
    "vacuum": (ItuRow(1.0, 0.0, 0.0, 0.0, 0.001, 100),),
    "concrete": (ItuRow(5.24, 0.0, 0.0462, 0.7822, 1, 100),),
    "brick": (ItuRow(3.91, 0.0, 0.0238, 0.16, 1, 40),),
    "plasterboard": (ItuRow(2.73, 0.0, 0.0085, 0.9395, 1, 100),),
    "wood": (ItuRow(1.99, 0.0, 0.0047, 1.0718, 0.001, 100),),
    "glass": (ItuRow(6.31, 0.0, 0.0036, 1.3394, 0.1, 100), ItuRow(5.79, 0.0, 0.0004, 1.658, 220, 450)),
    "ceiling_board": (ItuRow(1.48, 0.0, 0.0011, 1.0750, 1, 100), ItuRow(1.52, 0.0, 0.0029, 1.029, 220, 450)),
    "chipboard": (ItuRow(2.58, 0.0, 0.0217, 0.7800, 1, 100),),
    "plywood": (ItuRow(2.71, 0.0, 0.33, 0.0, 1, 40),),
    "marble": (ItuRow(7.074, 0.0, 0.0055, 0.9262, 1, 60),),
    "floorboard": (ItuRow(3.66, 0.0, 0.0044, 1.3515, 50, 100),),
    "metal": (ItuRow(1.0, 0.0, 1e7, 0.0, 1, 100),),
    "very_dry_ground": (ItuRow(3.0, 0.0, 0.00015, 2.52, 1, 10),),
    "medium_dry_ground": (ItuRow(15.0, -0.1, 0.035, 1.63, 1, 10),),
    "wet_ground": (ItuRow(30.0, -0.4, 0.15, 1.30, 1, 10),),
}


@dataclass(frozen=True)
class Material:
    """A homogeneous slab that scatters a share of the reflected field.

    Attributes
    ----------
    relative_permittivity : real part of the relative permittivity at the carrier, >= 1
    conductivity_s_m : conductivity in S/m at the carrier, >= 0
    thickness_m : thickness of the slab behind every face of an object, > 0
    scattering_coefficient : share S of the reflected field that is scattered, in [0, 1]; S^2 of the power
    scattering_directivity : alpha_R >= 1 of the directive model (Degli-Esposti et al., 2007), whose lobe is
        centred on the specular direction and narrows with it; None scatters evenly (Lambertian)
    is_itu : whether the electrical constants come from the ITU-R P.2040-3 table
    """

    name: str
    relative_permittivity: float
    conductivity_s_m: float
    thickness_m: float = 0.1
    scattering_coefficient: float = 0.0
    is_itu: bool = False
    scattering_directivity: int | None = None

    def __post_init__(self) -> None:
        for field, valid, allowed in (
            ("relative_permittivity", 1 <= self.relative_permittivity < np.inf, "must be >= 1"),
            ("conductivity_s_m", 0 <= self.conductivity_s_m < np.inf, "must be >= 0"),
            ("thickness_m", 0 < self.thickness_m < np.inf, "must be > 0"),
            ("scattering_coefficient", 0 <= self.scattering_coefficient <= 1, "must lie in [0, 1]"),
            ("scattering_directivity", (self.scattering_directivity or 1) >= 1, "must be >= 1"),
        ):
            if not valid:
                raise ValueError(f"{field} = {getattr(self, field)} (material '{self.name}'): {allowed}")

    def complex_permittivity(self, frequency_hz: float) -> complex:
        """Relative permittivity eps_r - j sigma / (2 pi f eps_0), time dependence exp(+j 2 pi f t).

        ITU-R P.2040-3, section 2.1.2.
        """
        loss = self.conductivity_s_m / (2 * np.pi * frequency_hz * VACUUM_PERMITTIVITY_F_M)
        return complex(self.relative_permittivity, -loss)


def itu_names(frequency_hz: float) -> list[str]:
    """Names of the ITU materials that are defined at this frequency, sorted."""
    return sorted(name for name in ITU_TABLE if _row(name, frequency_hz) is not None)


def itu_material(
    itu_name: str,
    frequency_hz: float,
    *,
    name: str | None = None,
    thickness_m: float = 0.1,
    scattering_coefficient: float = 0.0,
) -> Material:
    """Material of the ITU-R P.2040-3 table (section 2.1.4, table 3) at a frequency.

    Raises `ValueError` if the name is unknown or the material is not defined at this frequency. The message lists
    the materials that are defined.
    """
    f_ghz = frequency_hz / 1e9
    row = _row(itu_name, frequency_hz)
    if row is None:
        ranges = ", ".join(f"{r.f_min_ghz:g}-{r.f_max_ghz:g} GHz" for r in ITU_TABLE.get(itu_name, ()))
        reason = f"defined at {ranges} only" if ranges else "no such ITU material"
        allowed = ", ".join(itu_names(frequency_hz)) or "none"
        raise ValueError(f"itu = '{itu_name}' at {f_ghz:g} GHz: {reason}; allowed there: {allowed}")
    return Material(
        name or itu_name,
        relative_permittivity=row.a * f_ghz**row.b,
        conductivity_s_m=row.c * f_ghz**row.d,
        thickness_m=thickness_m,
        scattering_coefficient=scattering_coefficient,
        is_itu=True,
    )


def _row(itu_name: str, frequency_hz: float) -> ItuRow | None:
    f_ghz = frequency_hz / 1e9
    rows = ITU_TABLE.get(itu_name, ())
    return next((row for row in rows if row.f_min_ghz <= f_ghz <= row.f_max_ghz), None)
