"""The licence test: how a policy drives among drivers of every kind."""
