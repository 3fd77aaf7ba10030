"""Minimum speed: the floor |R e1| >= fraction as faces of a polygon or as a true circle."""
