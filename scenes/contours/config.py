"""Contours in scene files: one table per kind; `type` names the kind."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from scenes.contours import (
    Circle,
    ClosedSpline,
    Contour,
    Ellipse,
    OpenSpline,
    Polygon,
    Polyline,
    RoundedPolygon,
    rectangle,
)
from scenes.toml_config import ConfigModel, Pair

SMALLEST = 1e-6  # of a radius, a thickness or a scale


def _not_tiny(value: float) -> float:
    if value < SMALLEST:
        raise ValueError(f"must be {SMALLEST:g} or more")
    return value


Points = Annotated[tuple[Pair, ...], Field(strict=False, min_length=1)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_not_tiny)]
PositivePair = Annotated[tuple[Positive, Positive], Field(strict=False)]


class CircleConfig(ConfigModel):
    """A round contour."""

    type: Literal["circle"]
    center_m: Pair = Field(description="x, y of the centre")
    radius_m: Positive = Field(description="radius")

    def build(self) -> Contour:
        """The contour."""
        return Circle(np.array(self.center_m), self.radius_m)


class EllipseConfig(ConfigModel):
    """An ellipse; `rotation_deg` is the azimuth of its first semi-axis."""

    type: Literal["ellipse"]
    center_m: Pair = Field(description="x, y of the centre")
    semi_axes_m: PositivePair = Field(description="first and second semi-axis")
    rotation_deg: float = Field(0.0, description="azimuth of the first semi-axis")

    def build(self) -> Contour:
        """The contour."""
        return Ellipse(np.array(self.center_m), np.array(self.semi_axes_m), float(np.deg2rad(self.rotation_deg)))


class RectangleConfig(ConfigModel):
    """An axis-parallel rectangle between two x and two y coordinates."""

    type: Literal["rectangle"]
    x_m: Pair = Field(description="lowest and highest x")
    y_m: Pair = Field(description="lowest and highest y")

    def build(self) -> Contour:
        """The contour."""
        return rectangle(self.x_m, self.y_m)


class PolygonConfig(ConfigModel):
    """A polygon. `corner_radius_m` is the radius of each corner; all corners are sharp by default."""

    type: Literal["polygon"]
    vertices_m: Points = Field(description="x, y of the corners in order, the first not repeated")
    corner_radius_m: Annotated[tuple[float, ...], Field(strict=False)] | None = Field(
        None, description="radius of each corner; sharp by default"
    )

    @model_validator(mode="after")
    def _one_radius_per_vertex(self) -> PolygonConfig:
        n_radii = len(self.vertices_m) if self.corner_radius_m is None else len(self.corner_radius_m)
        if n_radii != len(self.vertices_m):
            raise ValueError(
                f"corner_radius_m has {n_radii} entries: one per vertex is needed, {len(self.vertices_m)}"
            )
        return self

    def build(self) -> Contour:
        """The contour."""
        if self.corner_radius_m is None:
            return Polygon(np.array(self.vertices_m))
        return RoundedPolygon(np.array(self.vertices_m), np.array(self.corner_radius_m))


class PolylineConfig(ConfigModel):
    """An open thin wall of straight pieces."""

    type: Literal["polyline"]
    points_m: Points = Field(description="x, y of the corners from one end to the other")

    def build(self) -> Contour:
        """The contour."""
        return Polyline(np.array(self.points_m))


class SplineConfig(ConfigModel):
    """An open thin curved wall through points."""

    type: Literal["spline"]
    points_m: Points = Field(description="x, y of points from one end to the other")

    def build(self) -> Contour:
        """The contour."""
        return OpenSpline(np.array(self.points_m))


class ClosedSplineConfig(ConfigModel):
    """A smooth solid through points; the first point is not repeated."""

    type: Literal["closed_spline"]
    points_m: Points = Field(description="x, y of points in order, the first not repeated")

    def build(self) -> Contour:
        """The contour."""
        return ClosedSpline(np.array(self.points_m))


ContourConfig = Annotated[
    CircleConfig
    | EllipseConfig
    | RectangleConfig
    | PolygonConfig
    | ClosedSplineConfig
    | PolylineConfig
    | SplineConfig,
    Field(discriminator="type"),
]
