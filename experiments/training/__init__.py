"""Training of classifiers and predictors on datasets."""
