"""The licence test: how a policy drives in every scenario among drivers of every kind."""
