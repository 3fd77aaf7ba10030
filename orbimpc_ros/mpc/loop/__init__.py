"""The receding-horizon loop: odometry and forecasts in, checked commands out."""
