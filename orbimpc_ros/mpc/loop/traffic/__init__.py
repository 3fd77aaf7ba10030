"""Traffic: bodies that are seen, and plans of other vehicles, as hazards to stay clear of."""
