"""Scores: one function for answers, one for predictions, one tidy row for every figure."""
