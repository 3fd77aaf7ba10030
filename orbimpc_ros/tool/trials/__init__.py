"""Trials of real nodes under faults: what is done to them, who watches, and what came of it."""
