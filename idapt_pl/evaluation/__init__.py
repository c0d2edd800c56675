"""Evaluation only: returns in the target, translation errors, distances between transitions. Nothing here trains."""
