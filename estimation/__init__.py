"""The estimation back-end: channel parameters, mapping, SLAM, object shapes, and their scores."""
