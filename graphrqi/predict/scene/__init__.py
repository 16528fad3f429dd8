"""The present as a predictor needs it: who drives where, and where they may have to stop."""
