"""Extended object estimation: incidence points in, object contours out."""
