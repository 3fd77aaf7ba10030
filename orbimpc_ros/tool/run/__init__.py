"""Processes, flights and their progress."""
