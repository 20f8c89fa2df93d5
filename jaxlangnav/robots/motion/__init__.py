"""Motion planners: from waypoints and what a scanner sees to wheel speeds (section 4.3)."""
