"""Features of drivers, from positions only: spectral, graph-signal, kinematic, interaction."""
