"""The room's measures, shared by layout, physics, hand and view.

Lengths in metres, angles in radians, time in seconds. Ours where no source is named.
"""

import numpy as np

ROOM = 4.0  # Length of a side. DeepMind's rooms are 3 x 3 and 4 x 4 m (Carvalho et al. 2021).
CEILING = 2.5
EYE = 1.0
"""Height of the camera above the floor."""

FRAMES = 4  # physics frames in an action: the paper
FRAME = 1 / 30  # duration of a physics frame: the paper
STEP = FRAMES * FRAME

AGENT_RADIUS = 0.25
AGENT_MASS = 20.0
"""Kilograms."""
DAMPING = 5.0  # 1/s: the rate at which every speed decays, so that the agent has momentum

NEAR_DISTANCE = 0.5  # an object is near a support up to this distance from its edge

FURNITURE_SIZE = np.array([[0.70, 0.45, 0.35], [0.30, 0.225, 0.03]])
"""Half length and half width of the footprint and height of the top, of bed and tray."""
LANDING = 0.005
"""A falling object lands on a top when its lowest point is no more than this below it."""
