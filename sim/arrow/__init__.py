"""Tables of unknown origin: looked through before Arrow reads them."""
