"""Camera rigs: which cameras a vehicle carries, where, with which lenses."""
