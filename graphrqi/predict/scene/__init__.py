"""The present as a predictor needs it: who drives where, and what may stop them."""
