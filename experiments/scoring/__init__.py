"""Scores of classifiers and predictors, with intervals over episodes."""
