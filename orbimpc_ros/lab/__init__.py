"""The laboratory: benchmarks, studies and the fault matrix."""
