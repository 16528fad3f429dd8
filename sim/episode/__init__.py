"""What happened in an episode or a recording: rows, observables, events and shown traits."""
