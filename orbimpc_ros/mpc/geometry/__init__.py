"""Rotations, orbitopes and polyhedra."""
