"""The prediction bench: errors on unseen episodes, and who will let a pedestrian go first."""
