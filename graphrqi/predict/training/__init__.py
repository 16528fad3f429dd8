"""Training the learned predictors and calibrating the numbers of the rollouts."""
