"""Files that people write: TOML read as frozen, strict models with all errors at once, and delimited text as tables."""
