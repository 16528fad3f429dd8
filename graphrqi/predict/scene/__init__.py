"""The present as a predictor needs it: drivers on their paths, and where they may have to stop."""
