"""Random worlds: they share only the labels' meaning with the simulated training traffic."""
