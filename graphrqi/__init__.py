"""GraphRQI: driver behaviour from the spectrum of the traffic graph."""
