"""BIDS `beh` datasets, made from journals or from counts: the same bytes for the same content. `analysis` reads them."""
