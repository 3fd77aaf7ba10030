"""The discrete dynamics and the cost, as functions of the planned rotations."""
