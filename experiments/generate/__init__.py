"""Makes labelled datasets: of scenarios, and of random worlds."""
