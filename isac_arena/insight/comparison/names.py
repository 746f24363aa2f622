"""What the quantities of `arena compare` are called in its table and its figure."""

GROUPS = {
    "channel": "Paths",
    "slam": "SLAM",
    "mapping": "Mapping",
    "tracks": "Tracks",
    "contours.mapping": "Contours, mapping",
    "contours.slam": "Contours, SLAM",
    "shapes.mapping": "Published contours, mapping",
    "shapes.slam": "Published contours, SLAM",
}
NAMES = {
    "gospa": "GOSPA",
    "detected": "significant ones detected, share",
    "aod_error": "AoD error",
    "aoa_error": "AoA error",
    "ip_to_surface": "incidence point to surface, median of a stop",
    "ip_height_error": "height error of incidence points, median of a stop",
    "iou": "overlap (IoU)",
    "modified_hausdorff": "modified Hausdorff distance",
    "seen_rmse": "RMSE, seen part",
    "full_rmse": "RMSE, whole contour",
}


def group_of(key: str) -> str:
    """The stage, and the map where there are two, that a quantity belongs to."""
    return GROUPS[key.rpartition(".")[0]]


def name_of(key: str) -> str:
    """The quantity in words, without its group."""
    name = key.rpartition(".")[2]
    return NAMES.get(name, name.replace("_", " "))
