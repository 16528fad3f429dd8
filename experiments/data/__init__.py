"""Datasets made, brought in, written out, checked and cut into windows."""
