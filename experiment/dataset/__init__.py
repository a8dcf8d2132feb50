"""BIDS `beh` datasets, made from journals or counts: the same bytes for the same content. `analysis` reads them."""
