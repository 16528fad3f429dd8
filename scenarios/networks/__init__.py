"""Road networks: the sources, the built nets, and the script that builds them."""
