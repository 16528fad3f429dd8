"""GraphRQI, certified: the default solver and the kernels that it is made of."""
