"""The eigenvalue algorithms that the certified solver is compared with, one per file."""
