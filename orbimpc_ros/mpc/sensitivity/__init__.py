"""Active constraints and their shadow prices."""
