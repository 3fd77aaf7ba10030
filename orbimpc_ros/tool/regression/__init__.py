"""Bags as regression tests: what was recorded, solved again, compared."""
