"""Protocol files: frozen models, loading with every error at once, the canonical form and its hash."""
