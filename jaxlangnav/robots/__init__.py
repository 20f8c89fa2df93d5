"""Robots: vehicle models, fiducial detection, adapters to robot middleware (section 4.3)."""
