"""Experiments: commands, studies, metrics and reports."""
