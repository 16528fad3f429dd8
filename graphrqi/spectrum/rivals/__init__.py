"""The eigenvalue algorithms of the paper's comparison, one per file."""
