"""The vehicle in a viewer."""

from __future__ import annotations

import numpy as np

# A paper dart: nose, wing tips, and the keel that tells up from down.
NOSE, LEFT, RIGHT, TAIL, KEEL = (
    (0.6, 0.0, 0.0),
    (-0.4, 0.32, 0.08),
    (-0.4, -0.32, 0.08),
    (-0.3, 0.0, 0.08),
    (-0.4, 0.0, -0.16),
)
DART = np.array([NOSE, LEFT, TAIL, NOSE, TAIL, RIGHT, NOSE, TAIL, KEEL])  # three triangles
SHADES = np.array([[70, 140, 190], [0, 90, 150], [40, 60, 80]], dtype=np.uint8)  # one for each
DART_COLORS = np.repeat(SHADES, 3, axis=0)
