"""Maps that come with recordings, read as a `sim.road.Road`: one file per format."""
