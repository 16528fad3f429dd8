"""Description of an episode or a recording: rows, observables, events and shown traits."""
