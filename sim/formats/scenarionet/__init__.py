"""ScenarioNet: one pickled dictionary per scenario, for MetaDrive and the tools around it.

References:
    Li et al. (2023), ScenarioNet, NeurIPS Datasets and Benchmarks.
"""
