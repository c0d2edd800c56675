"""Recordings with a known, undeclared effect in them: data for the benchmark of ``idapt diagnose``.

Nothing here imports ``idapt_pl``: the truth is made by text edits of the MJCF and by hand-written hooks.
"""
