"""Conversion between paths and a DeepMIMO v4 scenario: one matrix (receiver, path) per quantity.

Conventions of DeepMIMO v4: power in dBm between isotropic elements at a TX power of 0 dBm, phase and angles in
degrees, zenith angles instead of elevations, interactions as the digits of a number from TX to RX (1 reflection,
2 diffraction, 3 scattering, 4 transmission, 0 line of sight), strongest path first, NaN where a receiver has no
more paths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scenes.record import FloatArray, IntArray
from sim.propagation.paths import BounceKind, Paths

MAX_DIGITS = 15  # largest number of interactions that a float64 can encode
DIGIT_OF_KIND = {
    BounceKind.SPECULAR: 1,
    BounceKind.DIFFRACTION: 2,
    BounceKind.TARGET: 3,
    BounceKind.DIFFUSE: 3,
    BounceKind.REFRACTION: 4,
}
SAME_PLACE_M = 1e-3  # a stop this close to a receiver of a scenario is that receiver
KIND_OF_DIGIT = {digit: kind for kind, digit in DIGIT_OF_KIND.items()}
PATH_MATRICES = ("power", "phase", "delay", "aoa_az", "aoa_el", "aod_az", "aod_el", "inter")


@dataclass(frozen=True)
class PathScenario:
    """Paths from one TX to many receivers. The receivers have positions only, no headings and no clock."""

    tx_position_m: FloatArray  # (xyz,)
    rx_position_m: FloatArray  # (receiver, xyz)
    carrier_hz: float
    paths: tuple[Paths, ...]

    def at(self, receivers: IntArray) -> PathScenario:
        """The same scenario with these receivers (receiver,) only."""
        chosen = tuple(self.paths[index] for index in receivers)
        return replace(self, rx_position_m=self.rx_position_m[receivers], paths=chosen)

    def paths_at(self, position_m: FloatArray) -> Paths:
        """Paths of the receiver at a position (xyz,) in m; `ValueError` if no receiver is there."""
        distance = np.linalg.norm(self.rx_position_m - position_m, axis=1)
        nearest = int(distance.argmin())
        if distance[nearest] > SAME_PLACE_M:
            place = ", ".join(f"{value:g}" for value in position_m)
            raise ValueError(
                f"propagation.deepmimo: no receiver at ({place}) m, the nearest is {distance[nearest]:.3g} m away"
            )
        return self.paths[nearest]


def path_matrices(paths: Sequence[Paths], max_paths: int) -> dict[str, FloatArray]:
    """The matrices (receiver, path) of `PATH_MATRICES` and `inter_pos` (receiver, path, bounce, xyz) in m.

    Only the `max_paths` strongest paths of each receiver are kept. Raises `ValueError` if a path has more
    interactions than the code has digits.
    """
    chosen = [each.take("path", np.argsort(-each.power, kind="stable")[:max_paths]) for each in paths]
    n_paths = max((len(each) for each in chosen), default=0)
    n_bounces = max((int(each.n_interactions.max(initial=0)) for each in chosen), default=0)
    if n_bounces > MAX_DIGITS:
        raise ValueError(f"Paths.bounce: {n_bounces} interactions, a DeepMIMO code holds {MAX_DIGITS}")
    matrices = {name: np.full((len(chosen), n_paths), np.nan) for name in PATH_MATRICES}
    matrices["inter_pos"] = np.full((len(chosen), n_paths, n_bounces, 3), np.nan)
    for receiver, each in enumerate(chosen):
        for name, values in _columns(each).items():
            matrices[name][receiver, : len(each)] = values
        slots = min(n_bounces, each.vertex_m.shape[1])
        matrices["inter_pos"][receiver, : len(each), :slots] = each.vertex_m[:, :slots]
    return matrices


def _columns(paths: Paths) -> dict[str, FloatArray]:
    return {
        "power": 20 * np.log10(np.maximum(np.abs(paths.gain), np.finfo(float).tiny)),
        "phase": np.rad2deg(np.angle(paths.gain)),
        "delay": paths.delay_s,
        "aoa_az": np.rad2deg(paths.aoa_azimuth_rad),
        "aoa_el": 90 - np.rad2deg(paths.aoa_elevation_rad),
        "aod_az": np.rad2deg(paths.aod_azimuth_rad),
        "aod_el": 90 - np.rad2deg(paths.aod_elevation_rad),
        "inter": _codes(paths.bounce_kind),
    }


def paths_of_matrices(matrices: Mapping[str, FloatArray], receiver: int) -> Paths:
    """Paths of one receiver; their objects are unknown.

    Raises `ValueError` if a matrix holds an interaction that DeepMIMO does not define.
    """
    used = np.flatnonzero(np.isfinite(matrices["delay"][receiver]))
    row = {name: np.asarray(matrices[name][receiver][used], float) for name in PATH_MATRICES}
    kinds = _kinds(row["inter"])
    vertices = np.full((*kinds.shape, 3), np.nan)
    places = matrices.get("inter_pos")
    if places is not None:
        slots = min(kinds.shape[1], places.shape[2])
        vertices[:, :slots] = places[receiver][used][:, :slots]
    vertices[kinds == BounceKind.NONE] = np.nan
    return Paths(
        gain=10 ** (row["power"] / 20) * np.exp(1j * np.deg2rad(row["phase"])),
        delay_s=row["delay"],
        aod_azimuth_rad=np.deg2rad(row["aod_az"]),
        aod_elevation_rad=np.deg2rad(90 - row["aod_el"]),
        aoa_azimuth_rad=np.deg2rad(row["aoa_az"]),
        aoa_elevation_rad=np.deg2rad(90 - row["aoa_el"]),
        bounce_kind=kinds,
        bounce_object=np.full(kinds.shape, -1),
        vertex_m=vertices,
        object_name=np.zeros(0, str),
    )


def _codes(bounce_kind: IntArray) -> FloatArray:
    """Interactions (path, bounce) as decimal numbers (path,); the first interaction is the first digit."""
    code = np.zeros(len(bounce_kind))
    for slot in range(bounce_kind.shape[1]):
        kind = bounce_kind[:, slot]
        used = kind != BounceKind.NONE
        digit = np.array([DIGIT_OF_KIND[BounceKind(k)] for k in kind[used]], float)
        code[used] = 10 * code[used] + digit
    return code


def _kinds(code: FloatArray) -> IntArray:
    """The inverse of `_codes`: kinds (path, bounce), with at least one slot."""
    texts = [str(int(value)) if value > 0 else "" for value in code]
    kinds = np.full((len(code), max([1, *map(len, texts)])), BounceKind.NONE)
    for path, text in enumerate(texts):
        for slot, digit in enumerate(text):
            if int(digit) not in KIND_OF_DIGIT:
                raise ValueError(
                    f"inter = {text}: {digit} is no interaction of DeepMIMO; allowed are 1, 2, 3 and 4"
                )
            kinds[path, slot] = KIND_OF_DIGIT[int(digit)]
    return kinds
