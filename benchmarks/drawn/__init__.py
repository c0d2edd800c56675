"""Mechanisms and what is hidden in them, drawn at random (benchmarks/drawn_machines.py)."""
