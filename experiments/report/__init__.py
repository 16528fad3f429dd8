"""Reports: one self-contained page per run."""

from experiments.report.page import write_report

__all__ = ["write_report"]
