"""A run as one HTML page: what each grounding step did, from what the run folder holds."""

from idapt_pl.report.page import write_report

__all__ = ["write_report"]
