"""Shared by all learned models: the file format of their weights, and training with PyTorch."""
