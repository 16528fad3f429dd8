"""What all networks share: their inputs, the futures that they decode to, and the perceptron."""
