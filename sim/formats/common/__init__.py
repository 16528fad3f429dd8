"""What the readers of recordings share: columns, windows, units and the way to `Tracks`."""
