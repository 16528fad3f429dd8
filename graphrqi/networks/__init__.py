"""What all learned models share: the file format of their weights, and how PyTorch trains them."""
