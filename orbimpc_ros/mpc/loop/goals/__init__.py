"""Models of a moving goal: fitted side by side, weighed by evidence, given up when it changes."""
