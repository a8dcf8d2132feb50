"""Settings files: TOML read as frozen, strict models; all errors are reported at once, each with its line."""
