"""Methods that find optimal trajectories with proved bounds."""
