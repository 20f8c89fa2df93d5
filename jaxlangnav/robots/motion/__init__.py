"""Motion planning from waypoints and range scans to wheel speeds (section 4.3)."""
