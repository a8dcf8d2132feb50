"""Devices behind small ports, and their drivers; each driver imports its library inside."""
