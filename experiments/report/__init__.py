"""Reports: one self-contained page per run or bench, and one that compares several."""

from experiments.report.page import write_comparison, write_report

__all__ = ["write_comparison", "write_report"]
