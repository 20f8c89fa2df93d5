"""Motion planning from goals and range scans to wheel speeds (section 4.3)."""
