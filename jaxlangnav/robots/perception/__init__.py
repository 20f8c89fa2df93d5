"""Fiducial tags in camera pictures: drawn, found, and turned into things (section 4.3)."""
