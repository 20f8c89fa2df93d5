"""Robots with bodies: what drives the navigator in physics or in the real world (section 4.3).

``Robot`` is the door; ``drive`` runs a navigator against any robot to an ending. The kinematic
backend needs nothing beyond the package; ``jaxlangnav[robot]`` brings physics and cameras.
"""
