"""Runs and diagnoses as HTML pages, by one kit (:mod:`idapt_pl.report.html`)."""
