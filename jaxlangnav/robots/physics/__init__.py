"""Robots in MuJoCo: the bodies, the place they are in, and their cameras (section 4.3)."""
