"""Shared by all networks: their inputs, the futures that they decode to, and the perceptron."""
