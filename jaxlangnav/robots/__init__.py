"""Robots, simulated or real, and the loop by which a navigator drives them (section 4.3).

``Robot`` is the interface; ``drive`` runs a navigator on any robot to an ending. The kinematic
backend needs nothing beyond the package; ``jaxlangnav[robot]`` brings physics and cameras.
"""
