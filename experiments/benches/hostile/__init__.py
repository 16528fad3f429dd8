"""Files made to break readers: which are read, which refused, and what each of them costs."""
