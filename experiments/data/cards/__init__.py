"""What a dataset says of itself to the tools and catalogues of others."""
