"""Sweeps: tasks x targets x methods x seeds, each an ``idapt fit`` in a folder of its own."""
