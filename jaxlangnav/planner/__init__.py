"""Waypoints, their values, and when to stop (section 3.4)."""
