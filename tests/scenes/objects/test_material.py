"""Material constants against figures worked out by hand from ITU-R P.2040-3."""

import numpy as np
import pytest

from scenes.objects.material import ITU_TABLE, Material, itu_material, itu_names


@pytest.mark.parametrize(
    ("name", "permittivity", "conductivity"),
    [  # c * 60^d with log10(60) = 1.778151
        ("concrete", 5.24, 0.0462 * 10 ** (0.7822 * 1.778151)),
        ("glass", 6.31, 0.867),
        ("wood", 1.99, 0.3784),
        ("plasterboard", 2.73, 0.3981),
        ("ceiling_board", 1.48, 0.0897),
        ("metal", 1.0, 1e7),
    ],
)
def test_table_at_60_ghz(name, permittivity, conductivity):
    material = itu_material(name, 60e9)
    assert material.is_itu
    assert material.relative_permittivity == pytest.approx(permittivity)
    assert material.conductivity_s_m == pytest.approx(conductivity, rel=2e-3)


def test_frequency_dependence_and_second_range():
    wet = itu_material("wet_ground", 4e9)
    assert wet.relative_permittivity == pytest.approx(30 * 4**-0.4)
    assert itu_material("glass", 300e9).relative_permittivity == 5.79


def test_complex_permittivity():
    material = Material("x", 4.0, 1.0)
    # eps'' = 18 sigma / f_GHz up to the exact value of eps_0
    assert material.complex_permittivity(60e9) == pytest.approx(4 - 1j * 17.975 / 60, rel=1e-4)


@pytest.mark.parametrize("name", ["brick", "plywood", "wet_ground", "vinyl"])
def test_undefined_at_60_ghz_lists_what_is_allowed(name):
    with pytest.raises(ValueError, match=f"itu = '{name}' at 60 GHz: .*allowed there: .*concrete") as caught:
        itu_material(name, 60e9)
    assert "\n" not in str(caught.value)
    assert name not in itu_names(60e9)


def test_every_named_material_is_finite_at_60_ghz():
    for name in itu_names(60e9):
        material = itu_material(name, 60e9, name="mine", thickness_m=0.02, scattering_coefficient=0.3)
        assert material.name == "mine"
        assert np.isfinite(material.complex_permittivity(60e9))
    assert set(itu_names(60e9)) < set(ITU_TABLE)


@pytest.mark.parametrize(
    "change",
    [{"relative_permittivity": 0.5}, {"conductivity_s_m": -1.0}, {"thickness_m": 0.0},
     {"scattering_coefficient": 1.5}, {"relative_permittivity": float("nan")}],
)  # fmt: skip
def test_bad_constants(change):
    values = {"relative_permittivity": 2.0, "conductivity_s_m": 0.1} | change
    (field,) = change
    with pytest.raises(ValueError, match=rf"{field} = .*\(material 'x'\): must"):
        Material("x", **values)
