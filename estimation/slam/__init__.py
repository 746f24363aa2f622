"""Mapping and snapshot SLAM: channel parameters in, incidence points and receiver poses out."""
