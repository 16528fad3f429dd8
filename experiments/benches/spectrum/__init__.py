"""The spectrum bench: the paper's runtime table, measured."""
