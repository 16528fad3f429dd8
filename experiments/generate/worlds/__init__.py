"""Random worlds: traffic that differs from home in everything but what the labels mean."""
