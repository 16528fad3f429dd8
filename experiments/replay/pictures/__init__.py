"""Pictures and films of a replay, drawn without a browser."""
