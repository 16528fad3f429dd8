"""Ensembles of decision trees as plain arrays, and the kernel that evaluates them."""
