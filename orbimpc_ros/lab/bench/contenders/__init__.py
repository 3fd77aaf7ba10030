"""Solvers that ``orbimpc bench`` compares."""
