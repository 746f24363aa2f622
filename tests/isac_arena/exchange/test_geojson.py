"""Maps as GeoJSON: every layer is there and shapely reads it back."""

import json

import numpy as np
import pytest
import shapely

from isac_arena.exchange.geojson import map_geojson
from isac_arena.validation.scenarios.perfect_campaign import make_campaign


@pytest.fixture(scope="module")
def campaign():
    return make_campaign()


@pytest.fixture(scope="module")
def features(campaign):
    text = json.dumps(map_geojson(campaign.scene, campaign.results.slam), allow_nan=False)
    assert len(shapely.get_parts(shapely.from_geojson(text))) == len(json.loads(text)["features"])
    return json.loads(text)["features"]


def layer(features, name):
    return [each for each in features if each["properties"]["layer"] == name]


def test_every_layer_is_there(features, campaign):
    slam = campaign.results.slam
    assert len(layer(features, "truth")) == len(campaign.scene.objects)
    assert len(layer(features, "pose")) == len(campaign.truths)
    assert len(layer(features, "ip")) == len(slam.ips)
    assert len(layer(features, "shape")) == len(slam.shapes.center_m)
    assert len(layer(features, "contour")) == len(slam.contours)


def test_places_are_those_of_the_map(features, campaign):
    slam = campaign.results.slam
    places = [each["geometry"]["coordinates"] for each in layer(features, "ip")]
    np.testing.assert_allclose(places, slam.ips.position_m, atol=1e-4)
    for row, each in enumerate(layer(features, "contour")):
        drawn = shapely.from_geojson(json.dumps(each["geometry"]))
        assert drawn.geom_type == ("Polygon" if slam.contours.is_closed[row] else "LineString")
        np.testing.assert_allclose(
            shapely.get_coordinates(drawn)[: len(slam.contours.contour_m[row])],
            slam.contours.contour_m[row],
            atol=1e-4,
        )
        assert sum(each["properties"]["class_probability"].values()) == pytest.approx(1)
